"""Nonlinearities of a connection, one per file."""

from pinn_cli.system.nonlinearity.base import Nonlinearity
from pinn_cli.system.nonlinearity.duffing import Duffing
from pinn_cli.system.nonlinearity.linear import Linear
from pinn_cli.system.nonlinearity.power_damping import PowerDamping
from pinn_cli.system.nonlinearity.van_der_pol import VanDerPol

__all__ = ["Duffing", "Linear", "Nonlinearity", "PowerDamping", "VanDerPol"]
