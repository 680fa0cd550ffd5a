"""Where time histories come from, and the Record that everything else reads."""
