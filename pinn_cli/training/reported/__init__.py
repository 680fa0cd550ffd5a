"""From a solution to what is reported: histories, parameters, their uncertainty."""
