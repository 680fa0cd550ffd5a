"""Searching settings with Optuna: the loop of trials, how it goes on after a kill, and a report of what it found."""
