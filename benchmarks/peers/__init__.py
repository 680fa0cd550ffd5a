"""The same records solved by other people's packages: ``make bench-peers``."""
