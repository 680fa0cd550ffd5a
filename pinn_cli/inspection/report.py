"""What a look at a record leaves behind."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.inspection.inspection import Inspection
from pinn_cli.inspection.look_report import LookReport
from pinn_cli.inspection.spectra import spectra_table
from pinn_cli.report.text import WIDTH, Column, count, marked_lines, number, table_lines

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

_SHOWN, _NAME = 20, 26


@dataclass(frozen=True, eq=False, repr=False)
class InspectionReport(LookReport):
    """What :func:`pinn_cli.inspect` returns; ``print`` shows what the command prints.

    Attributes:
        found: All of it.
    """

    found: Inspection

    @cached_property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """``inspect``, ``peaks`` and ``spectra``."""
        found = self.found
        return {"inspect": found.channels, "peaks": found.peaks, "spectra": spectra_table(found.spectra)}

    @property
    def drawings(self) -> Mapping[str, Callable[[], Figure]]:
        """``inspect``: channels over time and frequency."""
        from pinn_cli.inspection.figure import inspection_figure

        return {"inspect": partial(inspection_figure, self.found)}

    @property
    def channels(self) -> pd.DataFrame:
        """A row for each channel: missing and clipped samples, mean, rms, band, noise."""
        return self.found.channels

    @property
    def peaks(self) -> pd.DataFrame:
        """Natural frequencies and damping ratios, beside those of the structure if one was given."""
        return self.found.peaks

    @property
    def notes(self) -> tuple[str, ...]:
        """What is odd about the record."""
        return tuple(self.found.notes)

    @property
    def settings(self) -> tuple[str, ...]:
        """What is proposed to run: ``run(*look.settings)``, with ``data=...`` where the record is in memory."""
        return tuple(self.found.settings)

    @property
    def command(self) -> str:
        """The same as it is typed."""
        return " ".join(self.found.command)

    def text(self) -> str:
        """See :class:`LookReport`."""
        return inspection_text(self.found)


def inspection_text(found: Inspection) -> str:
    """Sampling, channels, peaks, what is odd, and the command that is proposed."""
    sampling = found.sampling
    start, end = sampling.time[0], sampling.time[-1]
    lines = [
        f"{len(sampling.time)} samples from {start:.6g} to {end:.6g} s, at {sampling.rate:.6g} Hz",
        "",
        *_channels(found),
        "",
        *_peaks(found),
        *([""] if found.notes else []),
    ]
    for note in found.notes:
        lines += marked_lines(note[0].upper() + note[1:] + ("" if note.endswith("?") else "."))
    lines += ["", "To estimate:", f"  {found.command[0]}"]
    for word in found.command[1:]:  # on lines that end with a backslash between two words
        if len(lines[-1]) + len(word) + 3 > WIDTH:
            lines[-1] += "" if found.said.in_memory else " \\"
            lines.append(f"    {word}")
        else:
            lines[-1] += f" {word}"
    for remark in found.remarks:
        lines += ["", *marked_lines(remark[0].upper() + remark[1:] + ".")]
    return "\n".join(lines)


def _channels(found: Inspection) -> list[str]:
    table = found.channels.copy()
    table["channel"] = [textwrap.shorten(str(name), _NAME, placeholder="...") for name in table["channel"]]
    table["band"] = [
        f"{number(low, 3)} to {number(high, 3)}" if np.isfinite(high) else "-"
        for low, high in zip(table["band_low_hz"], table["band_high_hz"], strict=True)
    ]
    table["floor"] = [
        ("" if seen is True else "<" if np.isfinite(noise) else "") + number(float(noise), 3)
        for noise, seen in zip(table["noise"], table["noise_is_visible"], strict=True)
    ]
    columns = {
        "channel": Column("channel", -(_NAME + 1), str),
        "unit": Column("unit", -7, str),
        "rms": Column("rms", 9, lambda value: number(value, 3)),
        "band": Column("band (Hz)", 16, str),
        "floor": Column("noise", 10, str),
        "snr_db": Column("SNR (dB)", 9, lambda value: number(value, 3)),
        "missing_percent": Column("missing %", 10, lambda value: number(value, 2) if value else "0"),
        "clipped_percent": Column("clipped %", 10, lambda value: number(value, 2) if value else "0"),
    }
    more = [] if len(table) <= _SHOWN else [f"and {len(table) - _SHOWN} more: inspect.csv"]
    return [*table_lines(columns, table.head(_SHOWN)), *more]


def _peaks(found: Inspection) -> list[str]:
    if found.peaks.empty:
        return ["no natural frequency stands out"]
    columns = {
        "frequency_hz": Column("frequency (Hz)", 14, lambda value: number(value, 5)),
        "frequency_std_hz": Column("+-", 10, lambda value: number(value, 2)),
        "damping_percent": Column("damping (%)", 13, lambda value: number(value, 3)),
        "damping_std_percent": Column("+-", 10, lambda value: number(value, 2)),
    }
    columns["explained"] = Column("explained", 11, lambda value: number(value, 2))
    if np.isfinite(found.peaks["structure_hz"]).any():
        columns["mode"] = Column("mode", 6, count)
        columns["structure_hz"] = Column("structure (Hz)", 16, lambda value: number(value, 5))
        columns["difference_percent"] = Column("off (%)", 10, lambda value: number(value, 2))
    return table_lines(columns, found.peaks)
