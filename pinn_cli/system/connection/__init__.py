"""Nonlinearities of a connection, one per file."""

from pinn_cli.system.connection.base import Nonlinearity
from pinn_cli.system.connection.duffing import Duffing
from pinn_cli.system.connection.linear import Linear
from pinn_cli.system.connection.power_damping import PowerDamping
from pinn_cli.system.connection.van_der_pol import VanDerPol

__all__ = ["Duffing", "Linear", "Nonlinearity", "PowerDamping", "VanDerPol"]
