"""What a value may be, objects from nodes of the configuration, and the errors that name a setting."""
