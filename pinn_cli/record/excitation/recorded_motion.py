"""A recorded ground motion: read from a text file, and known between its samples."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from pinn_cli.record.files.on_disk import read_text
from pinn_cli.record.record import MINIMUM_SAMPLES
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import LARGEST, positive_number

# Between the samples the motion is that of its own sinusoids, up to the Nyquist frequency: by FFT at times so many
# times as dense, and by a spline of this degree between those (error below 1e-6 of the highest sinusoid). Zeros on
# either side keep the end of the record from its beginning. Of a measured history nobody knows that it is zero beyond
# its ends: `pinn_cli.record.between_samples` takes nothing of the kind for granted, and tells less (1e-5).
DENSER, SPLINE_DEGREE, ZEROS = 16, 5, 256
# Times are printed with few digits: let each be off the regular axis by this part of a step.
TIME_TOLERANCE = 0.1
_SEPARATOR = re.compile(r"[,;\s]+")
SETTING = "excitation.path"
# Of a line that is told, characters.
SHOWN = 60


class RecordedMotion:
    """A motion by its samples; the ground is at rest before the first one and after the last one.

    Args:
        step: From sample to sample, s.
        samples: (N,), m/s^2, the first one at time 0.
    """

    def __init__(self, step: float, samples: np.ndarray) -> None:
        self.step, self.samples = step, samples
        padded = np.concatenate((np.zeros(ZEROS), samples, np.zeros(ZEROS)))
        # Not above: it takes a second to import, and every run reads this module.
        from scipy.interpolate import make_interp_spline
        from scipy.signal import resample

        dense = resample(padded, DENSER * len(padded))
        time = (step / DENSER) * np.arange(len(dense)) - step * ZEROS
        self._spline = make_interp_spline(time, dense, k=SPLINE_DEGREE)
        self._ends = time[0], time[-1]

    @property
    def duration(self) -> float:
        """Time from the first sample to the last, s."""
        return self.step * (len(self.samples) - 1)

    @property
    def nyquist(self) -> float:
        """Half the sampling rate, Hz."""
        return 0.5 / self.step

    def power_above(self, frequency: float) -> float:
        """Share of the power above a frequency (Hz), 0 to 1."""
        power = np.abs(np.fft.rfft(self.samples)) ** 2
        above = np.fft.rfftfreq(len(self.samples), self.step) > frequency
        return float(power[above].sum() / power.sum())

    def __call__(self, time: np.ndarray) -> np.ndarray:
        """(M,), m/s^2, at times (M,), s."""
        low, high = self._ends
        return np.where((time >= low) & (time <= high), self._spline(np.clip(time, low, high)), 0.0)

    @classmethod
    def read(cls, path: Path, step: float | None) -> RecordedMotion:
        """From a text file: lines of time (s) and acceleration; or, with ``step``, accelerations one after the other.

        Lines before the first number are a header. Columns are separated by commas, semicolons, blanks or tabs.

        Raises:
            InputError: Naming ``excitation.path`` or ``excitation.step``; tells the line.
        """
        rows, first = _rows(path)
        widths = {len(row) for row in rows}
        columns = np.array(rows) if widths == {2} else None
        has_times = columns is not None and bool(np.all(np.diff(columns[:, 0]) > 0))
        if step is not None:
            if has_times:
                raise InputError("excitation.step", step, "null", f"{path.name} has times of its own")
            values, step = np.concatenate([np.array(row) for row in rows]), positive_number("excitation.step", step)
        elif columns is None or not has_times:
            allowed = "given, the time between two values in s"
            hint = f"{path.name} has no two columns, growing time and acceleration"
            raise InputError("excitation.step", None, allowed, hint)
        else:
            values, step = columns[:, 1], _uniform_step(path, columns[:, 0], first)
        if len(values) < MINIMUM_SAMPLES or not values.any():
            found = f"{len(values)} values" + ("" if values.any() else ", all of them 0")
            raise InputError(SETTING, path, f"a motion of {MINIMUM_SAMPLES} values or more", found)
        if (largest := float(np.abs(values).max())) > LARGEST:
            raise InputError(SETTING, path, f"a motion below {LARGEST:g}", f"it reaches {largest:g}")
        return cls(step, values)


def _rows(path: Path) -> tuple[list[list[float]], int]:
    """The numbers of every line after the header, and the number of the first such line."""
    lines = read_text(path, SETTING).splitlines()
    rows: list[list[float]] = []
    first = 0
    for number, line in enumerate(lines, start=1):
        cells = [cell for cell in _SEPARATOR.split(line.strip()) if cell]
        row = _numbers(cells)
        if row is None or not np.isfinite(row).all():
            if rows:
                shown = f"{path.name}, line {number}"
                raise InputError(SETTING, path, "a file of finite numbers", f"{shown} reads {line.strip()[:SHOWN]!r}")
        elif row:
            first = first or number
            rows.append(row)
    if not rows:
        raise InputError(SETTING, path, "a file of numbers", f"{path.name} has none")
    return rows, first


def _numbers(cells: list[str]) -> list[float] | None:
    try:
        return [float(cell) for cell in cells]
    except ValueError:
        return None


def _uniform_step(path: Path, time: np.ndarray, first: int) -> float:
    """The step of times (N,) that the file has from line ``first`` on."""
    step = float(time[-1] - time[0]) / (len(time) - 1)
    usual = float(np.median(np.diff(time)))
    off = np.abs(time - (time[0] + step * np.arange(len(time))))
    if off.max() > TIME_TOLERANCE * usual:
        row = int(np.argmax(np.abs(np.diff(time) - usual))) + 1
        hint = f"{path.name}, line {first + row}: {time[row]:g} s after {time[row - 1]:g} s"
        raise InputError(SETTING, path, f"a file with one step, {usual:g} s", hint)
    return step
