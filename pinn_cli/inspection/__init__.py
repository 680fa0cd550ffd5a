"""A look at a measured record before anything is estimated (``pinn-run inspect``)."""
