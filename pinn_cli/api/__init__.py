"""The program as Python has it: `run`, `load`, `inspect`, `modes`, their results, structures, records."""
