"""The structure: its equation of motion, parameters, nonlinearities, matrices and model error."""

from pinn_cli.system.building import build_chain
from pinn_cli.system.chain import Chain
from pinn_cli.system.drawing import draw

__all__ = ["Chain", "build_chain", "draw"]
