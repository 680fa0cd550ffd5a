"""Whether a run's estimate can be trusted, why not, and what the likely cause is: never with the truth in hand."""
