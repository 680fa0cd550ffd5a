"""A finished run as a model: what it knows, in one file that a later run reads."""
