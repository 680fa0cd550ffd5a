"""Excitations, one per file."""

from pinn_cli.record.excitation.banded_noise import BandedNoise
from pinn_cli.record.excitation.excitation import Excitation
from pinn_cli.record.excitation.ground_motion import GroundMotion
from pinn_cli.record.excitation.impulse import Impulse
from pinn_cli.record.excitation.sine_sweep import SineSweep

__all__ = ["BandedNoise", "Excitation", "GroundMotion", "Impulse", "SineSweep"]
