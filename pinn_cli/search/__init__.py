"""Searching settings with Hydra's Optuna sweeper: how one goes on after a kill, and a report of what it found."""
