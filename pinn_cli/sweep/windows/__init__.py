"""A run that solves a record window by window: each goes on where the last one handed over."""
