"""What is observed, what is unknown, what is reported."""
