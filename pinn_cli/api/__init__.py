"""The program as Python has it: `run` and `load`, their results, and structures and records to begin with."""
