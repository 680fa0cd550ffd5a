"""The referee: how often the program is right, on random structures that other code has made."""
