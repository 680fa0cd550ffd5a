"""Where time histories come from, and the Record that everything else reads."""

from pinn_cli.record.record import Measurements, Record, Truth
from pinn_cli.record.response import QUANTITIES, UNITS, Response

__all__ = ["QUANTITIES", "UNITS", "Measurements", "Record", "Response", "Truth"]
