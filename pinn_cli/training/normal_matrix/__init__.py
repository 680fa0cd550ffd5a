"""The normal matrix of splines: which rows it adds up, and its elimination."""
