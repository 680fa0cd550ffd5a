"""What ``pinn-run modes`` prints and leaves behind."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from pinn_cli.inspection.joined import JoinedMode, JoinedModes
from pinn_cli.inspection.modes import ModalRecord, ModesAtSensors, mac_table, mode_table
from pinn_cli.report.text import Column, count, marked_lines, number, table_lines
from pinn_cli.runs.writing import write_table

if TYPE_CHECKING:
    from pinn_cli.system.modes import NaturalModes

# Sensors whose shapes are printed, and modes of all records whose assurance is.
SENSORS_SHOWN, MODES_SHOWN = 10, 12
# Records differ where chance makes that much of a difference so rarely, or where their shapes are less alike; relative
# deviation of a record's scale that is told.
RARELY, ALIKE, LOOSE = 0.01, 0.9, 0.1


def write_modes(
    records: Sequence[ModalRecord], structure: NaturalModes | None, directory: Path, figures: bool = True
) -> str:
    """Write the modes and figures; the text that is printed.

    ``modes.csv`` has the modes; of several records those of all together, and ``modes_of_records.csv`` each record's.

    Args:
        records: With their modes.
        structure: Whose modes stand beside; None: no parameters were given.
        directory: Of the run.
        figures: Whether to draw.
    """
    shown, joined = records[0], None
    several = len(records) > 1
    if several:
        each = [mode_table(record, structure) for record in records]
        for i, of_one in enumerate(each, start=1):
            of_one.insert(0, "record", i)
        of_records = pd.concat([of_one for of_one in each if len(of_one)] or each, ignore_index=True)
        write_table(of_records, directory / "modes_of_records.csv")
        joined = JoinedModes.of(records)
    table = mode_table(joined or shown, structure)
    if joined is not None:
        table = _with_agreement(table, joined)
    write_table(table, directory / "modes.csv")
    assurance = mac_table(records)
    write_table(assurance, directory / "mac.csv")
    if figures:
        from pinn_cli.inspection.shapes import shapes_figure
        from pinn_cli.inspection.stabilisation import stabilisation_figure
        from pinn_cli.report.figures.style import save

        save(stabilisation_figure(records), directory / "figures", "stabilisation")
        if len(table):
            save(shapes_figure(joined or shown, joined.joined if joined else ()), directory / "figures", "shapes")
    lines: list[str] = []
    for i, record in enumerate(records, start=1):
        lines += [*([f"record {i}"] if several else []), *_of_record(record), ""]
    if table.empty:
        lines.append("no mode stands out of noise")
    else:
        lines += [
            *(["all records together", ""] if several else []),
            *_frequencies(table),
            "",
            *_shapes(joined or shown),
        ]
    if joined is not None:
        lines += _doubts(joined)
        if 0 < len(assurance) <= MODES_SHOWN:
            lines += ["", "MAC between records", *_assurance(assurance)]
    return "\n".join(lines)


def _with_agreement(table: pd.DataFrame, joined: JoinedModes) -> pd.DataFrame:
    """With columns that say which records show a mode, and how well they agree."""
    values: dict[str, Any] = {
        "records": [" ".join(str(part.record + 1) for part in one.parts) for one in joined.joined],
        "frequency_agreement": [one.agreement[0] for one in joined.joined],
        "damping_agreement": [one.agreement[1] for one in joined.joined],
        "least_record_mac": [float(np.min(one.mac)) if len(one.parts) > 1 else np.nan for one in joined.joined],
    }
    for place, (name, column) in enumerate(values.items(), start=list(table.columns).index("explained") + 1):
        table.insert(place, name, column)
    return table


def _doubts(joined: JoinedModes) -> list[str]:
    """What is to be said of records that do not go together."""
    lines = []
    for r in joined.apart:
        says = f"record {r + 1} has no sensor in common with those before it: its modes stand by themselves"
        lines += marked_lines(f"{says}; name the same DOF, or column, where a reference sensor stayed in its place")
    for number_, one in enumerate(joined.joined, start=1):
        lines += [
            line for sentence in _differences(one, joined) for line in marked_lines(f"mode {number_}: {sentence}")
        ]
    for i, j, alike in joined.opposed:
        says = (
            f"modes {i + 1} and {j + 1}, of different records, have one frequency and another shape at common sensors"
        )
        lines += marked_lines(f"{says} (MAC {alike:.2f}): are they two modes, or has a sensor another place or sign?")
    return lines


def _differences(one: JoinedMode, joined: JoinedModes) -> Iterator[str]:
    modes = [(part.record + 1, joined.records[part.record].modes[part.mode]) for part in one.parts]
    if one.agreement[0] < RARELY:
        each = ", ".join(f"{number(mode.frequency, 5)} in record {r}" for r, mode in modes)
        yield f"frequencies differ beyond their intervals ({each} Hz): did temperature, mass or level change?"
    if one.agreement[1] < RARELY:
        each = ", ".join(f"{number(100.0 * mode.damping, 3)} in record {r}" for r, mode in modes)
        yield f"damping ratios differ beyond their intervals ({each} %)"
    if len(modes) > 1 and np.min(one.mac) < ALIKE:
        worst = int(np.argmin(one.mac))
        says = f"the shape of record {modes[worst][0]} differs from that of all (MAC {one.mac[worst]:.2f})"
        yield f"{says}: is a sensor elsewhere, or its sign or unit another one?"
    if len(modes) > 1 and np.max(one.scale_std) > LOOSE:
        worst = int(np.argmax(one.scale_std))
        within = f"within {100.0 * one.scale_std[worst]:.0f} % (one standard deviation)"
        yield f"reference sensors tell the size of its shape in record {modes[worst][0]} {within} only"


def _of_record(record: ModalRecord) -> list[str]:
    sampling = record.sampling
    acting = ", ".join(signal.name for signal in record.acting)
    acts = f"what acts: {acting}" if acting else "what acts was not measured: random forces are assumed"
    taken = f"{len(sampling.time)} samples at {sampling.rate:.6g} Hz, {sampling.duration:.6g} s"
    lines = [f"{taken}; sensors: {len(record.sensors)}", *textwrap.wrap(acts, 100)]
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
    if "records" in table:
        columns["records"] = Column("records", 9, str)
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


def _shapes(record: ModesAtSensors) -> list[str]:
    shown = record.names[:SENSORS_SHOWN]
    table = pd.DataFrame(record.shapes.real[:, : len(shown)], columns=shown)
    table.insert(0, "mode", range(1, len(table) + 1))
    columns = {"mode": Column("mode", 4, count)}
    for name in shown:
        columns[name] = Column(
            textwrap.shorten(name, 9, placeholder=".."), 10, lambda value: f"{value:.3f}" if np.isfinite(value) else "-"
        )
    more = [] if len(shown) == len(record.names) else [f"and {len(record.names) - len(shown)} more sensors: modes.csv"]
    return ["shape at sensors", *table_lines(columns, table), *more]


def _assurance(table: pd.DataFrame) -> list[str]:
    labels = {f"record_{r}_mode_{i}": f"{r}.{i}" for r, i in zip(table["record"], table["mode"], strict=True)}
    shown = table.assign(label=list(labels.values()))
    columns = {"label": Column("mode", -6, str), "frequency": Column("Hz", 9, lambda value: number(value, 4))} | {
        name: Column(label, 7, lambda value: number(value, 2)) for name, label in labels.items()
    }
    return table_lines(columns, shown)
