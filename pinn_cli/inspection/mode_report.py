"""What ``pinn-run modes`` prints and leaves behind."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pinn_cli.inspection.look_report import LookReport
from pinn_cli.inspection.modes import ModalRecord, mac_table, mode_table
from pinn_cli.inspection.spectra import spectra_table
from pinn_cli.report.text import Column, count, marked_lines, number, table_lines

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pinn_cli.system.modes import NaturalModes

# Sensors whose shapes are printed, and modes of all records whose assurance is.
SENSORS_SHOWN, MODES_SHOWN = 10, 12


@dataclass(frozen=True, eq=False, repr=False)
class ModesReport(LookReport):
    """What :func:`pinn_cli.modes` returns; ``print`` shows what the command prints.

    Attributes:
        records: With their modes.
        structure: Whose modes stand beside; None: no parameters were given.
    """

    records: Sequence[ModalRecord]
    structure: NaturalModes | None

    @cached_property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """``modes``, ``mac`` and ``spectra``."""
        spectra = [spectra_table(record.spectra) for record in self.records]
        return {
            "modes": self._below(self._modes), "mac": mac_table(self.records), "spectra": self._below(spectra),
        }  # fmt: skip

    @property
    def drawings(self) -> Mapping[str, Callable[[], Figure]]:
        """``stabilisation``: poles by order over the singular values of the spectra."""
        from pinn_cli.inspection.stabilisation import stabilisation_figure

        return {"stabilisation": partial(stabilisation_figure, self.records)}

    @property
    def modes(self) -> pd.DataFrame:
        """A row for each mode: frequency (Hz), damping ratio and shape with 90 % intervals."""
        return self.tables["modes"]

    @property
    def mac(self) -> pd.DataFrame:
        """Modal assurance criterion between all modes of all records."""
        return self.tables["mac"]

    @cached_property
    def _modes(self) -> list[pd.DataFrame]:
        """Of every record."""
        return [mode_table(record, self.structure) for record in self.records]

    def _below(self, tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
        """Those of the records in one, with their numbers where there are several."""
        if len(tables) == 1:
            return tables[0]
        numbered = [table.assign(record=i)[["record", *table]] for i, table in enumerate(tables, start=1)]
        return pd.concat([table for table in numbered if len(table)] or numbered, ignore_index=True)

    def text(self) -> str:
        """See :class:`LookReport`."""
        several, lines = len(self.records) > 1, []
        for i, (record, table) in enumerate(zip(self.records, self._modes, strict=True), start=1):
            lines += [f"record {i}", ""] if several else []
            lines += [*_of_record(record, table), ""]
        if several and 0 < len(self.mac) <= MODES_SHOWN:
            lines += ["MAC between records", *_assurance(self.mac), ""]
        return "\n".join(lines[:-1])


def _of_record(record: ModalRecord, table: pd.DataFrame) -> list[str]:
    sampling = record.sampling
    acting = ", ".join(signal.name for signal in record.acting)
    acts = f"what acts: {acting}" if acting else "what acts was not measured: random forces are assumed"
    taken = f"{len(sampling.time)} samples at {sampling.rate:.6g} Hz, {sampling.duration:.6g} s"
    lines = [f"{taken}; sensors: {len(record.sensors)}", *textwrap.wrap(acts, 100), ""]
    if table.empty:
        lines.append("no mode stands out of noise")
    else:
        lines += [*_frequencies(table), "", *_shapes(record)]
    machines = record.identified.machines
    if machines:
        named = ", ".join(number(f, 4) for f in machines)
        lines += marked_lines(f"steady lines at {named} Hz, as of machines or of mains: no modes.")
    return lines


def _frequencies(table: pd.DataFrame) -> list[str]:
    shown = table.copy()
    shown["frequency_90"] = [f"{a} to {b}" for a, b in _digits(table, "frequency", "lower_90", "upper_90", 1.0)]
    interval = ("damping_ratio", "damping_ratio_lower_90", "damping_ratio_upper_90")
    shown["damping_90"] = [f"{a} to {b}" for a, b in _digits(table, *interval, 100.0)]
    columns = {
        "mode": Column("mode", 4, count),
        "frequency": Column("frequency (Hz)", 16, lambda value: number(value, 5)),
        "frequency_90": Column("90 %", 20, str),
        "damping_ratio": Column("damping (%)", 13, lambda value: number(100.0 * value, 3)),
        "damping_90": Column("90 %", 18, str),
        "fdd_frequency": Column("FDD (Hz)", 10, lambda value: number(value, 4)),
    }
    if np.isfinite(table["prescribed_frequency"]).any():
        columns["prescribed_frequency"] = Column("structure", 11, lambda value: number(value, 4))
        columns["mac"] = Column("MAC", 7, lambda value: number(value, 3))
    return table_lines(columns, shown)


def _digits(table: pd.DataFrame, value: str, lower: str, upper: str, factor: float) -> list[tuple[str, str]]:
    """Ends of intervals with as many digits as tell them apart."""
    found = []
    for centre, a, b in zip(table[value], table[lower], table[upper], strict=True):
        digits = max(2, int(np.ceil(np.log10(max(centre / max(b - a, 1e-300), 1.0)))) + 2)
        found.append((number(factor * a, min(digits, 9)), number(factor * b, min(digits, 9))))
    return found


def _shapes(record: ModalRecord) -> list[str]:
    shown = record.names[:SENSORS_SHOWN]
    table = pd.DataFrame(record.shapes.real[:, : len(shown)], columns=shown)
    table.insert(0, "mode", range(1, len(table) + 1))
    columns = {"mode": Column("mode", 4, count)}
    for name in shown:
        columns[name] = Column(textwrap.shorten(name, 9, placeholder=".."), 10, lambda value: f"{value:.3f}")
    more = [] if len(shown) == len(record.names) else [f"and {len(record.names) - len(shown)} more sensors: modes.csv"]
    return ["shape at sensors", *table_lines(columns, table), *more]


def _assurance(table: pd.DataFrame) -> list[str]:
    labels = {f"record_{r}_mode_{i}": f"{r}.{i}" for r, i in zip(table["record"], table["mode"], strict=True)}
    shown = table.assign(label=list(labels.values()))
    columns = {"label": Column("mode", -6, str), "frequency": Column("Hz", 9, lambda value: number(value, 4))} | {
        name: Column(label, 7, lambda value: number(value, 2)) for name, label in labels.items()
    }
    return table_lines(columns, shown)
