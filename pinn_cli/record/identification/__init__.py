"""Natural frequencies, damping ratios and shapes from a record alone, without a model."""
