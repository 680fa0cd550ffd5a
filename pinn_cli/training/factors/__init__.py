"""What says something about the unknowns of a record: one kind of factor a file."""
