"""Response, parameters and their uncertainty of structural chains, by physics-informed neural networks."""
