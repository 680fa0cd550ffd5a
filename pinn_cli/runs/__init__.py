"""The life of a run's directory: identity, lock, resume, interruption, checkpoints, files written whole."""
