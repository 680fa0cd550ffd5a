"""``spectra.csv``: what a look at a record has found over frequency, as numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from pinn_cli.record.cross_spectra import CrossSpectra
from pinn_cli.record.signal import Signal


def spectra_table(spectra: CrossSpectra[Signal]) -> pd.DataFrame:
    """A row for each frequency; units stand in brackets behind the columns' names.

    ``frequency_hz``; ``psd_CHANNEL``, one-sided power spectral densities. Where something that acts was measured,
    ``frf_SENSOR_INPUT_real`` and ``_imag``, frequency responses by least squares with all noise in the sensors (H1),
    and ``coherence_SENSOR`` with all that acts, 0 to 1. A channel is called ``acceleration_3``.
    """
    sensors, acting = len(spectra.sensors), len(spectra.acting)
    every = [*spectra.sensors, *spectra.acting]
    names, units = _names(every), [_in_brackets(signal.shown_unit) for signal in every]
    columns: dict[str, np.ndarray] = {"frequency_hz": spectra.frequency}
    for i, (name, unit) in enumerate(zip(names, units, strict=True)):
        columns[_headed(f"psd_{name}", f"{unit}^2/Hz" if unit else "")] = spectra.density[:, i]
    for i in range(sensors):
        for j in range(acting):
            of_input = sensors + j
            unit = f"{units[i]}/{units[of_input]}" if units[i] and units[of_input] else ""
            response = spectra.response[:, i, j]
            for part, values in (("real", response.real), ("imag", response.imag)):
                columns[_headed(f"frf_{names[i]}_{names[of_input]}_{part}", unit)] = values
    if acting:
        columns |= {f"coherence_{names[i]}": spectra.coherence[:, i] for i in range(sensors)}
    return pd.DataFrame(columns).iloc[1:].reset_index(drop=True)  # at 0 Hz is nothing: channels are about their means


def _in_brackets(unit: str) -> str:
    """A unit as a part of another one."""
    return unit if unit.isalpha() or not unit else f"({unit})"


def _headed(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def _names(signals: Sequence[Signal]) -> list[str]:
    """What each measures and where; the column of the file where nobody says that, or another one measures the same."""
    named = ["_".join(filter(None, (s.quantity, s.place))) if s.quantity else s.column for s in signals]
    return [s.column if named.count(name) > 1 else name for s, name in zip(signals, named, strict=True)]
