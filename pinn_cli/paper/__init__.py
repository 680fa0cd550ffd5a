"""The whole paper from one command: every run of its tables, the tables, the figures and one report."""
