"""From a likelihood of the parameters to their posterior distribution."""
