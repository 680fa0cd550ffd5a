"""Training by the gradient of one weighted loss: what the optimisers share, and one file per optimiser."""
