"""What stands between the first solution of a problem and the one that is reported: one step a file."""
