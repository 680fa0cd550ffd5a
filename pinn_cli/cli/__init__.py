"""The command: options, the typed configuration, one line per error, exit status."""
