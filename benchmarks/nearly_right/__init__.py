"""Machines that are nearly what the fitted model says: `make bench-nearly-right`."""
