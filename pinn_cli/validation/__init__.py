"""How good an estimate is, told without the truth: what a search for settings minimises."""
