"""Gauss-Newton of linear readouts: normal equations with a band, and weights that the evidence finds."""
