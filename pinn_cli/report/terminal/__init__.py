"""What a run prints at its end, as plain text that fits 100 columns."""
