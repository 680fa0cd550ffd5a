"""The structure: its equation of motion, parameters, connections, damping, matrices, modes and model error."""
