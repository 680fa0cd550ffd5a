"""Estimators beside the network, for comparison, one per file."""
