"""How a record's motion begins: anyhow, or at rest."""

from __future__ import annotations

from pinn_cli.record.amplitudes import motion_amplitudes
from pinn_cli.record.record import Record

FREE, REST = "free", "rest"
CHOICES = (FREE, REST)

# A structure that somebody calls at rest still moves a little: so much of what it does later.
RESIDUAL_MOTION = 1e-3


def initial_deviation(record: Record, initial_motion: str) -> tuple[float, float] | None:
    """Prior standard deviations of every DOF's displacement (m) and velocity (m/s) at the record's first sample.

    A thousandth of the record's rms displacement and velocity where the motion begins at rest; None where nothing is
    known about its beginning.
    """
    if initial_motion == FREE:
        return None
    size = motion_amplitudes(record)
    return RESIDUAL_MOTION * size["displacement"], RESIDUAL_MOTION * size["velocity"]
