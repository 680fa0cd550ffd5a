"""Networks N(t; theta), one per file."""
