"""Where time histories come from, and the Record that everything else reads."""

from pinn_cli.record.record import QUANTITIES, UNITS, Measurements, Record, Response, Truth

__all__ = ["QUANTITIES", "UNITS", "Measurements", "Record", "Response", "Truth"]
