"""Following runs with an experiment tracker: what was set, how the losses went, what came of it."""
