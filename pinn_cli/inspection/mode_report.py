"""What ``pinn-run modes`` prints and leaves behind."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pinn_cli.inspection.modes import ModalRecord, mac_table, mode_table
from pinn_cli.report.text import Column, count, marked_lines, number, table_lines
from pinn_cli.runs.writing import write_table

if TYPE_CHECKING:
    from pinn_cli.system.modes import NaturalModes

# Sensors whose shapes are printed, and modes of all records whose assurance is.
SENSORS_SHOWN, MODES_SHOWN = 10, 12


def write_modes(
    records: Sequence[ModalRecord], structure: NaturalModes | None, directory: Path, figures: bool = True
) -> str:
    """Write ``modes.csv``, ``mac.csv`` and ``figures/stabilisation``; the text that is printed.

    Args:
        records: With their modes.
        structure: Whose modes stand beside; None: no parameters were given.
        directory: Of the run.
        figures: Whether to draw.
    """
    tables = [mode_table(record, structure) for record in records]
    several = len(records) > 1
    for i, table in enumerate(tables if several else (), start=1):
        table.insert(0, "record", i)
    found = pd.concat([table for table in tables if len(table)] or tables, ignore_index=True)
    write_table(found, directory / "modes.csv")
    assurance = mac_table(records)
    write_table(assurance, directory / "mac.csv")
    if figures:
        from pinn_cli.inspection.stabilisation import stabilisation_figure
        from pinn_cli.report.figures.style import save

        save(stabilisation_figure(records), directory / "figures", "stabilisation")
    lines: list[str] = []
    for i, (record, table) in enumerate(zip(records, tables, strict=True), start=1):
        lines += [f"record {i}", ""] if several else []
        lines += [*_of_record(record, table), ""]
    if several and 0 < len(assurance) <= MODES_SHOWN:
        lines += ["MAC between records", *_assurance(assurance), ""]
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
