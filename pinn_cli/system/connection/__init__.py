"""Nonlinearities of a connection, one per file."""

from pinn_cli.system.connection.baber_noori import BaberNoori
from pinn_cli.system.connection.bouc_wen import BoucWen
from pinn_cli.system.connection.duffing import Duffing
from pinn_cli.system.connection.friction import Friction
from pinn_cli.system.connection.gap import Gap
from pinn_cli.system.connection.jenkins import Jenkins
from pinn_cli.system.connection.linear import Linear
from pinn_cli.system.connection.nonlinearity import Hysteresis, Nonlinearity
from pinn_cli.system.connection.polynomial import Polynomial
from pinn_cli.system.connection.power_damping import PowerDamping
from pinn_cli.system.connection.spline import Spline
from pinn_cli.system.connection.van_der_pol import VanDerPol

__all__ = [
    "BaberNoori",
    "BoucWen",
    "Duffing",
    "Friction",
    "Gap",
    "Hysteresis",
    "Jenkins",
    "Linear",
    "Nonlinearity",
    "Polynomial",
    "PowerDamping",
    "Spline",
    "VanDerPol",
]
