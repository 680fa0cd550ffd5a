"""What a look at records has found: ``pinn-run inspect`` and ``modes`` print and write it, Python has it as it is.

``spectra.csv`` is of both.
"""

from __future__ import annotations

import shlex
import textwrap
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pinn_cli.inspection.proposal import Said
from pinn_cli.record.cross_spectra import CrossSpectra
from pinn_cli.record.signal import Sampling, Signal
from pinn_cli.report.text import WIDTH, Column, count, marked_lines, number, table_lines
from pinn_cli.runs.workbook import write_workbook
from pinn_cli.runs.writing import write_table
from pinn_cli.settings.errors import InputError, suggestion

if TYPE_CHECKING:
    import os

    from matplotlib.figure import Figure

_SHOWN, _NAME_WIDTH = 20, 26


class LookReport(ABC):
    """Tables and figures by the names of their files, and the text that the command prints."""

    @property
    @abstractmethod
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """Name to table."""

    @property
    @abstractmethod
    def drawings(self) -> Mapping[str, Callable[[], Figure]]:
        """Name to what draws the figure."""

    @abstractmethod
    def text(self) -> str:
        """What the command prints."""

    @property
    def spectra(self) -> pd.DataFrame:
        """Power spectral densities, frequency responses and coherences over frequency, units in the columns' names."""
        return self.tables["spectra"]

    def figure(self, name: str = "") -> Figure:
        """A matplotlib figure, which a notebook shows: one of `drawings`, by default the first of them.

        Raises:
            InputError: There is none of that name.
        """
        from pinn_cli.report.figures.style import for_notebooks

        name = name or next(iter(self.drawings))
        if name not in self.drawings:
            raise InputError("figure", name, f"one of {', '.join(self.drawings)}", suggestion(name, self.drawings))
        return for_notebooks(self.drawings[name]())

    def write(self, directory: Path, figures: bool = True) -> None:
        """Write every table as CSV and, if they are wanted, the figures under ``figures``."""
        for name, table in self.tables.items():
            write_table(table, directory / f"{name}.csv")
        if figures:
            from pinn_cli.report.figures.style import save

            for name, draw in self.drawings.items():
                save(draw(), directory / "figures", name)

    def to_excel(self, path: str | os.PathLike[str]) -> Path:
        """Write an Excel file (.xlsx) with a sheet for each table.

        Raises:
            InputError: It has another suffix, a table has more rows than a sheet, or openpyxl is not installed.
            WriteError: The disk does not take it.
        """
        return write_workbook(self.tables, path)

    def __repr__(self) -> str:
        return self.text()


@dataclass(frozen=True, eq=False, repr=False)
class InspectionReport(LookReport):
    """What :func:`pinn_cli.inspect` returns; ``print`` shows what the command prints.

    Attributes:
        sampling: When the record's samples were taken.
        signals: Its columns.
        channels: A row for each channel: missing and clipped samples, mean, rms, band, noise.
        cross_spectra: Spectra of the columns that vary.
        peaks: Natural frequencies and damping ratios, beside those of the structure if one was given.
        notes: What is odd about the record.
        said: By the command that looked.
        settings: What is proposed to run: ``run(*look.settings)``, with ``data=...`` where the record is in memory.
        remarks: Sentences beside them.
    """

    sampling: Sampling
    signals: Sequence[Signal]
    channels: pd.DataFrame
    cross_spectra: CrossSpectra[Signal]
    peaks: pd.DataFrame
    notes: tuple[str, ...]
    said: Said
    settings: tuple[str, ...]
    remarks: Sequence[str] = ()

    @cached_property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """``inspect``, ``peaks`` and ``spectra``."""
        return {"inspect": self.channels, "peaks": self.peaks, "spectra": spectra_table(self.cross_spectra)}

    @property
    def drawings(self) -> Mapping[str, Callable[[], Figure]]:
        """``inspect``: channels over time and frequency."""
        from pinn_cli.inspection.figures import inspection_figure

        return {"inspect": partial(inspection_figure, self.sampling, self.channels, self.cross_spectra, self.peaks)}

    @property
    def words(self) -> list[str]:
        """Of the command; of a record in memory, of a call of Python."""
        if self.said.in_memory:
            first, *others = self.settings
            return [f"run({first!r},", *(f"{setting!r}," for setting in others), "data=...)"]
        return [shlex.quote(word) for word in ("pinn-run", *self.said.options, *self.settings)]

    @property
    def command(self) -> str:
        """The settings as they are typed."""
        return " ".join(self.words)

    def text(self) -> str:
        """Sampling, channels, peaks, what is odd, and the command that is proposed."""
        sampling = self.sampling
        digits = 2 - int(np.floor(np.log10(sampling.step)))
        start, end = (round(float(sampling.time[i]), digits) for i in (0, -1))
        lines = [
            f"{len(sampling.time)} samples from {start:.12g} to {end:.12g} s, at {sampling.rate:.6g} Hz",
            "",
            *_channel_lines(self.channels),
            "",
            *_peak_lines(self.peaks),
            *([""] if self.notes else []),
        ]
        for note in self.notes:
            lines += marked_lines(note[0].upper() + note[1:] + ("" if note.endswith("?") else "."))
        lines += ["", "To estimate:", f"  {self.words[0]}"]
        for word in self.words[1:]:  # on lines that end with a backslash between two words
            if len(lines[-1]) + len(word) + 3 > WIDTH:
                lines[-1] += "" if self.said.in_memory else " \\"
                lines.append(f"    {word}")
            else:
                lines[-1] += f" {word}"
        for remark in self.remarks:
            lines += ["", *marked_lines(remark[0].upper() + remark[1:] + ".")]
        return "\n".join(lines)


def _channel_lines(channels: pd.DataFrame) -> list[str]:
    table = channels.copy()
    table["channel"] = [textwrap.shorten(str(name), _NAME_WIDTH, placeholder="...") for name in table["channel"]]
    table["band"] = [
        f"{number(low, 3)} to {number(high, 3)}" if np.isfinite(high) else "-"
        for low, high in zip(table["band_low_hz"], table["band_high_hz"], strict=True)
    ]
    for shown, column, bound in (("floor", "noise", "<"), ("ratio", "snr_db", ">")):
        table[shown] = [
            ("" if seen is True or not np.isfinite(value) else bound) + number(float(value), 3)
            for value, seen in zip(table[column], table["noise_is_visible"], strict=True)
        ]
    columns = {
        "channel": Column("channel", -(_NAME_WIDTH + 1), str),
        "unit": Column("unit", -7, str),
        "rms": Column("rms", 9, lambda value: number(value, 3)),
        "band": Column("band (Hz)", 16, str),
        "floor": Column("noise", 10, str),
        "ratio": Column("SNR (dB)", 9, str),
        "missing_percent": Column("missing %", 10, lambda value: number(value, 2) if value else "0"),
        "clipped_percent": Column("clipped %", 10, lambda value: number(value, 2) if value else "0"),
    }
    more = [] if len(table) <= _SHOWN else [f"and {len(table) - _SHOWN} more: inspect.csv"]
    return [*table_lines(columns, table.head(_SHOWN)), *more]


def _peak_lines(peaks: pd.DataFrame) -> list[str]:
    if peaks.empty:
        return ["no natural frequency stands out"]
    columns = {
        "frequency_hz": Column("frequency (Hz)", 14, lambda value: number(value, 5)),
        "frequency_std_hz": Column("+-", 10, lambda value: number(value, 2)),
        "damping_percent": Column("damping (%)", 13, lambda value: number(value, 3)),
        "damping_std_percent": Column("+-", 10, lambda value: number(value, 2)),
        "explained": Column("explained", 11, lambda value: number(value, 2)),
    }
    if np.isfinite(peaks["structure_hz"]).any():
        columns["mode"] = Column("mode", 6, count)
        columns["structure_hz"] = Column("structure (Hz)", 16, lambda value: number(value, 5))
        columns["difference_percent"] = Column("off (%)", 10, lambda value: number(value, 2))
    return table_lines(columns, peaks)


def spectra_table(spectra: CrossSpectra[Signal]) -> pd.DataFrame:
    """A row for each frequency; units stand in brackets behind the columns' names.

    ``frequency_hz``; ``psd_CHANNEL``, one-sided power spectral densities. Where something that acts was measured,
    ``frf_SENSOR_INPUT_real`` and ``_imag``, frequency responses by least squares with all noise in the sensors (H1),
    and ``coherence_SENSOR`` with all that acts, 0 to 1. A channel is called ``acceleration_3``.
    """
    sensors, acting = len(spectra.sensors), len(spectra.acting)
    signals = [*spectra.sensors, *spectra.acting]
    names, units = _names(signals), [signal.shown_unit for signal in signals]
    units = [unit if unit.isalpha() or not unit else f"({unit})" for unit in units]  # as parts of others
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


def _headed(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name


def _names(signals: Sequence[Signal]) -> list[str]:
    """What each measures and where; the column of the file where nobody says that, or another one measures the same."""
    named = ["_".join(filter(None, (s.quantity, s.place))) if s.quantity else s.column for s in signals]
    return [s.column if named.count(name) > 1 else name for s, name in zip(signals, named, strict=True)]
