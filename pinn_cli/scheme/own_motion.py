"""How near a structure comes to a record when it moves by itself: the spectra of its free run and of the sensors.

A strongly nonlinear structure may do nothing that any linear one does, and from a wrong start its motion parts from the
measured one within a few periods. The power spectra of the two are still alike where its stiffness is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pinn_cli.record.channels import channels
from pinn_cli.record.cross_spectra import CrossSpectra
from pinn_cli.record.free_run import NoFreeRunError, affordable, free_run
from pinn_cli.record.record import Record
from pinn_cli.record.response import Response
from pinn_cli.scheme.linear_fit import ABOVE_FLOOR, WIDTHS, lines_in_band
from pinn_cli.system.structure import Structure


def distance(structure: Structure, records: Sequence[Record]) -> float:
    """Root mean square of the logarithms of power over measured power, of all sensors in the records' bands.

    Returns:
        Infinity where the structure has no free run under one of the records.
    """
    squares = []
    for record in records:
        part = affordable(structure, record)
        try:
            squares.append(_logarithms(part, free_run(structure, part)) ** 2)
        except NoFreeRunError:
            return np.inf
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def _logarithms(record: Record, motion: Response) -> np.ndarray:
    """Of power over measured power, flat, weighed as the sensors stand out of their noise."""
    sensors = channels(record)
    measured, moved = (
        CrossSpectra.of_bands(record, shown, [], lines_in_band(record))
        for shown in (sensors, [replace(sensor, measured=sensor.of(motion)) for sensor in sensors])
    )
    kernel = measured.smoothing(WIDTHS[0])
    power, floor = np.maximum(kernel @ measured.power, 1e-300), ABOVE_FLOOR * measured.floor
    logarithms: np.ndarray = power / (power + floor) * np.log((kernel @ moved.power + floor) / power)
    return logarithms.reshape(-1)
