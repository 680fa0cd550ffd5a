"""Many runs from one command: where each lies, what became of it, their tables, their summary and their figure."""
