"""How the residuals are made small."""
