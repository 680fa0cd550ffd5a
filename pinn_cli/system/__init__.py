"""The structure: its equation of motion, parameters, connections, damping, matrices, modes and model error."""

from pinn_cli.system.building import build_chain
from pinn_cli.system.structure import Structure

__all__ = ["Structure", "build_chain"]
