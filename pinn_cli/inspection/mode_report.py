"""What ``pinn-run modes`` prints and leaves behind: modes beside those of a structure, and how records agree."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy.optimize import linear_sum_assignment

from pinn_cli.inspection.modes import FEWEST_SENSORS, JoinedMode, JoinedModes, ModalRecord, mac_table
from pinn_cli.inspection.report import LookReport, spectra_table
from pinn_cli.record.identification.modes import assurance
from pinn_cli.report.text import Column, count, marked_lines, number, table_lines
from pinn_cli.system.priors import HALF_WIDTH_90
from pinn_cli.system.quantities import MOTION

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pinn_cli.system.modes import NaturalModes

MODE_COLUMNS = (
    "mode", "frequency", "lower_90", "upper_90", "damping_ratio", "damping_ratio_lower_90", "damping_ratio_upper_90",
    "mac", "prescribed_frequency", "prescribed_damping_ratio", "explained", "fdd_frequency", "fdd_mac",
)  # fmt: skip
# Sensors whose shapes are printed, and modes of all records whose assurance is.
SHAPES_SHOWN, MODES_SHOWN = 10, 12
# Records differ where chance makes that much of a difference so rarely, or where their shapes are less alike; relative
# deviation of a record's scale that is told.
RARE_CHANCE, LEAST_ALIKE, LOOSE = 0.01, 0.9, 0.1


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
    def joined(self) -> JoinedModes | None:
        """The modes of several records together; None of one."""
        return JoinedModes.of(self.records) if len(self.records) > 1 else None

    @property
    def shown(self) -> ModalRecord | JoinedModes:
        """The modes of all records."""
        return self.joined or self.records[0]

    @cached_property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """``modes``, ``mac`` and ``spectra``; of several records ``modes_of_records`` too."""
        tables = {"modes": mode_table(self.shown, self.structure), "mac": mac_table(self.records)}
        if self.joined is not None:
            tables["modes"] = _with_agreement(tables["modes"], self.joined)
            tables["modes_of_records"] = _below([mode_table(record, self.structure) for record in self.records])
        return tables | {"spectra": _below([spectra_table(record.spectra) for record in self.records])}

    @property
    def drawings(self) -> Mapping[str, Callable[[], Figure]]:
        """``stabilisation``: poles by order over the singular values of the spectra; ``shapes``, of modes."""
        from pinn_cli.inspection.figures import shapes_figure, stabilisation_figure

        drawings: dict[str, Callable[[], Figure]] = {"stabilisation": partial(stabilisation_figure, self.records)}
        if len(self.modes):
            drawings["shapes"] = partial(shapes_figure, self.shown, self.joined.joined if self.joined else ())
        return drawings

    @property
    def modes(self) -> pd.DataFrame:
        """A row for each mode: frequency (Hz), damping ratio and shape with 90 % intervals."""
        return self.tables["modes"]

    @property
    def mac(self) -> pd.DataFrame:
        """Modal assurance criterion between all modes of all records."""
        return self.tables["mac"]

    def text(self) -> str:
        """See :class:`LookReport`."""
        several, lines = len(self.records) > 1, list[str]()
        for i, record in enumerate(self.records, start=1):
            lines += [*([f"record {i}"] if several else []), *_of_record(record), ""]
        if self.modes.empty:
            lines.append("no mode stands out of noise")
        else:
            together = ["all records together", ""] if several else []
            lines += [*together, *_frequencies(self.modes), "", *_shapes(self.shown)]
        if self.joined is not None:
            lines += [line for doubt in _doubts(self.joined) for line in marked_lines(doubt)]
            if 0 < len(self.mac) <= MODES_SHOWN:
                lines += ["", "MAC between records", *_assurance(self.mac)]
        return "\n".join(lines)


def mode_table(record: ModalRecord | JoinedModes, structure: NaturalModes | None) -> pd.DataFrame:
    """A row for each mode, columns `MODE_COLUMNS`, then its displacement at every sensor with its 90 % interval.

    Modes of the structure stand beside, if its parameters were given.
    """
    partners = _partners(record, structure)
    rows = []
    for i, mode in enumerate(record.modes):
        row = dict.fromkeys(MODE_COLUMNS, np.nan) | {
            "mode": i + 1, "frequency": mode.frequency, "damping_ratio": mode.damping, "explained": mode.explained,
        }  # fmt: skip
        row["lower_90"], row["upper_90"] = mode.frequency_interval
        row["damping_ratio_lower_90"], row["damping_ratio_upper_90"] = mode.damping_interval
        row["fdd_frequency"], row["fdd_mac"] = record.peak(i)
        if structure is not None and i in partners:
            other, row["mac"] = partners[i]
            row["prescribed_frequency"] = float(structure.frequencies[other])
            row["prescribed_damping_ratio"] = float(structure.damping_ratios[other])
        for name, value, std in zip(record.names, record.shapes[i].real, record.shape_std(i), strict=True):
            row |= {f"shape_{name}": value, f"shape_{name}_lower_90": value - HALF_WIDTH_90 * std,
                    f"shape_{name}_upper_90": value + HALF_WIDTH_90 * std}  # fmt: skip
        rows.append(row)
    return pd.DataFrame(rows, columns=None if rows else list(MODE_COLUMNS))


def _partners(record: ModalRecord | JoinedModes, structure: NaturalModes | None) -> dict[int, tuple[int, float]]:
    """Of a mode's number the number of the structure's mode, and the MAC, NaN where too few sensors have a DOF."""
    if structure is None or not record.modes:
        return {}
    usable = np.flatnonzero(np.isfinite(structure.frequencies) & (structure.frequencies > 0.0))
    at = [(i, int(s.place) - 1) for i, s in enumerate(record.sensors) if s.quantity in MOTION and s.place.isdecimal()]
    at = [(i, dof) for i, dof in at if dof < len(structure.of_dofs)]
    f = np.array([mode.frequency for mode in record.modes])
    distance = np.abs(np.log(f[:, None] / structure.frequencies[usable]))
    alike = np.full(distance.shape, np.nan)
    for i, shape in enumerate(record.shapes):
        there = [(sensor, dof) for sensor, dof in at if np.isfinite(shape[sensor])]
        if len(there) >= FEWEST_SENSORS:
            sensors, dofs = map(list, zip(*there, strict=True))
            alike[i] = assurance(shape[None, sensors], structure.of_dofs[dofs][:, usable].T)[0]
    pairs = linear_sum_assignment(distance + 1.0 - np.nan_to_num(alike))
    return {int(i): (int(usable[j]), float(alike[i, j])) for i, j in zip(*pairs, strict=True)}


def _below(tables: Sequence[pd.DataFrame]) -> pd.DataFrame:
    """Those of the records in one, with their numbers where there are several."""
    if len(tables) == 1:
        return tables[0]
    numbered = [table.assign(record=i)[["record", *table]] for i, table in enumerate(tables, start=1)]
    return pd.concat([table for table in numbered if len(table)] or numbered, ignore_index=True)


def _with_agreement(table: pd.DataFrame, joined: JoinedModes) -> pd.DataFrame:
    """With columns that say which records show a mode, and how well they agree."""
    values = {
        "records": [" ".join(str(part.record + 1) for part in mode.parts) for mode in joined.joined],
        "frequency_agreement": [mode.agreement[0] for mode in joined.joined],
        "damping_agreement": [mode.agreement[1] for mode in joined.joined],
        "least_record_mac": [float(np.min(mode.mac)) if len(mode.parts) > 1 else np.nan for mode in joined.joined],
    }
    place = list(table.columns).index("explained") + 1
    return pd.concat([table.iloc[:, :place], pd.DataFrame(values), table.iloc[:, place:]], axis=1)


def _doubts(joined: JoinedModes) -> Iterator[str]:
    """What is to be said of records that do not go together."""
    for r in joined.unconnected:
        says = f"record {r + 1} has no sensor in common with those before it: its modes stand by themselves"
        yield f"{says}; name the same DOF, or column, where a reference sensor stayed in its place"
    for i, mode in enumerate(joined.joined, start=1):
        yield from (f"mode {i}: {sentence}" for sentence in _differences(mode))
    for i, j, mac in joined.opposed:
        says = f"modes {i + 1} and {j + 1}, of different records, have one frequency and another shape"
        yield f"{says} at common sensors (MAC {mac:.2f}): are they two modes, or has a sensor another place or sign?"


def _differences(joined_mode: JoinedMode) -> Iterator[str]:
    modes = [(part.record + 1, part.mode) for part in joined_mode.parts]
    if joined_mode.agreement[0] < RARE_CHANCE:
        frequencies = ", ".join(f"{number(mode.frequency, 5)} in record {r}" for r, mode in modes)
        yield f"frequencies differ beyond their intervals ({frequencies} Hz): did temperature, mass or level change?"
    if joined_mode.agreement[1] < RARE_CHANCE:
        ratios = ", ".join(f"{number(100.0 * mode.damping, 3)} in record {r}" for r, mode in modes)
        yield f"damping ratios differ beyond their intervals ({ratios} %)"
    if len(modes) > 1 and np.min(joined_mode.mac) < LEAST_ALIKE:
        worst = int(np.argmin(joined_mode.mac))
        says = f"the shape of record {modes[worst][0]} differs from that of all (MAC {joined_mode.mac[worst]:.2f})"
        yield f"{says}: is a sensor elsewhere, or its sign or unit another one?"
    if len(modes) > 1 and np.max(joined_mode.scale_std) > LOOSE:
        worst = int(np.argmax(joined_mode.scale_std))
        within = f"within {100.0 * joined_mode.scale_std[worst]:.0f} % (one standard deviation)"
        yield f"reference sensors tell the size of its shape in record {modes[worst][0]} {within} only"


def _of_record(record: ModalRecord) -> list[str]:
    sampling = record.sampling
    acting = ", ".join(signal.name for signal in record.acting)
    acts = f"what acts: {acting}" if acting else "what acts was not measured: random forces are assumed"
    taken = f"{len(sampling.time)} samples at {sampling.rate:.6g} Hz, {sampling.duration:.6g} s"
    lines = [f"{taken}; sensors: {len(record.sensors)}", *textwrap.wrap(acts, 100)]
    return [*lines, *(line for remark in record.remarks for line in marked_lines(f"{remark}."))]


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
    texts = []
    for centre, a, b in zip(table[value], table[lower], table[upper], strict=True):
        digits = max(2, int(np.ceil(np.log10(max(centre / max(b - a, 1e-300), 1.0)))) + 2)
        texts.append((number(factor * a, min(digits, 9)), number(factor * b, min(digits, 9))))
    return texts


def _shapes(record: ModalRecord | JoinedModes) -> list[str]:
    shown = list(record.names[:SHAPES_SHOWN])
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
