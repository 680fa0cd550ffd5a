"""Many estimates in one process: the paper's cases over noise seeds, and chains of growing nonlinearity."""
