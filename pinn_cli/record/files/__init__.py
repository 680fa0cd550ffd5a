"""Files of numbers, a format each: from a path to named columns. What a column means is said elsewhere."""
