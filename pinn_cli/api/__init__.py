"""The program as Python has it: `run`, `load`, `inspect` and `modes`, their results, and structures and records to begin with."""
