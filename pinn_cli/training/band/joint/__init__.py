"""Several records of one structure, solved together: the normal equations of each, and a border that they share."""
