"""Measurements of speed and scaling: `make bench`. Never part of the tests."""
