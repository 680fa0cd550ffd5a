"""Records as programs of measurement leave them: twelve files of one rig of two storeys, and more."""

from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import cont2discrete

RATE, SAMPLES, GRAVITY = 50.0, 600, 9.80665
MASS, STIFFNESS, DAMPING = 2.0, 1500.0, 4.0
BEGIN = datetime(2026, 11, 26, 23, 59, 55)


@cache
def rig() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (N,), s, force on DOF 1 (N,), N, and accelerations (N, 2), m/s^2, of two masses; 1 % of noise."""
    random, fine = np.random.default_rng(4), 10  # steps of the simulation in one of the record
    spectrum = np.fft.rfft(random.normal(size=SAMPLES))
    spectrum[np.fft.rfftfreq(SAMPLES, 1.0 / RATE) > 8.0] = 0.0
    force = 10.0 * fine * np.fft.irfft(spectrum, fine * SAMPLES)
    shape = np.array([[2.0, -1.0], [-1.0, 1.0]])
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [-STIFFNESS / MASS * shape, -DAMPING / MASS * shape]])
    b = np.array([[0.0], [0.0], [1.0 / MASS], [0.0]])
    step, push, _, through, _ = cont2discrete((a, b, np.eye(4), np.zeros((4, 1))), 1.0 / RATE / fine, "foh")
    state, states = np.zeros(4), []
    for f in force:
        states.append(state + through[:, 0] * f)
        state = step @ state + push[:, 0] * f
    motion = np.array(states) @ a[2:].T
    motion[:, 0] += force / MASS
    seen = (force[::fine], motion[::fine])
    noisy = [x + 0.01 * x.std(axis=0) * random.normal(size=x.shape) for x in seen]
    return np.arange(SAMPLES) / RATE, noisy[0], noisy[1]


Stamp = Callable[[float], str]
Writer = Callable[[Path], object]


def _lines(rows: Sequence[Sequence[str]], separator: str) -> str:
    return "".join(separator.join(row) + "\n" for row in rows)


def _rows(stamp: Stamp | None, comma: bool = False, unit: tuple[float, float] = (1.0, 1.0)) -> list[list[str]]:
    """Cells: a stamp of its time, if any, and force and accelerations in these units."""
    times, f, a = rig()
    values = np.column_stack([f / unit[0], a / unit[1]])
    cells = [[f"{x:.6g}".replace(".", "," if comma else ".") for x in row] for row in values]
    return cells if stamp is None else [[stamp(t), *row] for t, row in zip(times.tolist(), cells, strict=True)]


def _text(head: str, separator: str, stamp: Stamp | None, encoding: str = "utf-8", **cells: Any) -> Writer:
    """Writes lines and the rows below them."""
    return lambda path: path.write_text(head + _lines(_rows(stamp, **cells), separator), encoding=encoding)


def _date(pattern: str, after: str = "") -> Stamp:
    """A date with its milliseconds behind the pattern."""

    def stamp(t: float) -> str:
        moment = BEGIN + timedelta(seconds=t)
        return f"{moment.strftime(pattern)}{moment.microsecond // 1000:03d}{after}"

    return stamp


_seconds = "{:.2f}".format


def _comma_seconds(t: float) -> str:
    return f"{t:.2f}".replace(".", ",")


def gravities_and_millimetres(path: Path) -> None:
    """No force: what the wind does to the rig, in g, with an offset, and a displacement in mm."""
    t, _, a = rig()
    random = np.random.default_rng(5)
    lvdt = np.cumsum(np.cumsum(a[:, 1] - a[:, 1].mean())) / RATE**2
    lvdt -= np.polyval(np.polyfit(t, lvdt, 5), t)
    shown = np.column_stack([t, a / GRAVITY + [0.15, 0.0], 1e3 * lvdt + 0.01 * random.normal(size=len(t))])
    rows = [[f"{x:.6g}" for x in row] for row in shown]
    path.write_text("Time [s],S1 [g],S2 [g],L2 [mm]\n" + _lines(rows, ","))


def semicolons(path: Path) -> None:
    """One at the end of every line."""
    rows = [[*row, ""] for row in _rows(_comma_seconds, comma=True)]
    path.write_text("Zeit;F1;A1;A2;\n" + _lines(rows, ";"))


def mat_struct(path: Path) -> None:
    from scipy.io import savemat

    _, f, a = rig()
    savemat(path, {"rig": {"fs": RATE, "force": f, "acc": a, "operator": "Smith"}})


def universal(path: Path) -> None:
    pyuff = pytest.importorskip("pyuff")
    t, f, a = rig()
    common = {"binary": 0, "func_type": 1, "rsp_dir": 3, "ref_node": 0, "ref_dir": 0, "x": t, "abscissa_spacing": 1,
              "abscissa_spec_data_type": 17, "orddenom_spec_data_type": 0, "z_axis_spec_data_type": 0, "id1": "NONE",
              "abscissa_inc": 1.0 / RATE}  # fmt: skip
    sets = [(f, 1, 13, "N"), (a[:, 0], 1, 12, "m/s^2"), (a[:, 1], 2, 12, "m/s^2")]
    pyuff.UFF(str(path)).write_sets([
        pyuff.prepare_58(
            **common, data=values, rsp_node=node, ordinate_spec_data_type=kind, ordinate_axis_units_lab=unit
        )
        for values, node, kind, unit in sets
    ])  # fmt: skip


def labview(path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    _, f, a = rig()
    told = {"wf_increment": 1.0 / RATE, "wf_start_offset": 0.0}
    columns = {"cDAQ1Mod1/ai0": (f, "N"), "cDAQ1Mod2/ai0": (a[:, 0] / GRAVITY, "g"),
               "cDAQ1Mod2/ai1": (a[:, 1] / GRAVITY, "g")}  # fmt: skip
    with nptdms.TdmsWriter(path) as file:
        file.write_segment([nptdms.ChannelObject("Untitled", name, values, told | {"unit_string": unit})
                            for name, (values, unit) in columns.items()])  # fmt: skip


def excel(path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    t, f, a = rig()
    book = openpyxl.Workbook()
    book.active.append(["notes"])
    sheet = book.create_sheet("Record")
    sheet.append(["Rig 3", None])
    sheet.append([])
    sheet.append(["Date", "Force 1 (kN)", "Acc 1 (g)", "Acc 2 (g)"])
    for i in range(len(t)):
        sheet.append([BEGIN + timedelta(seconds=float(t[i])), f[i] / 1e3, *(a[i] / GRAVITY)])
    book.save(path)


# LabVIEW's: two headers, units and the step in the second one, and a name of comments that no row has.
LOGGER_TEXT = (
    "LabVIEW Measurement\nSeparator\tTab\nTime\t12:27:49.01\n***End_of_Header***\t\n\t\t\t\t\nChannels\t3\n"
    "Samples\t600\t600\t600\t\nY_Unit_Label\tkN\tm/s^2\tm/s^2\t\nX0\t0.0E+0\t0.0E+0\t0.0E+0\t\n"
    "Delta_X\t0.020000\t0.020000\t0.020000\t\n***End_of_Header***\t\t\t\t\nX_Value\tF1\tA1\tA2\tComment\n"
)
CATMAN = (
    "catman AP\t5.4.1\nT0\t26.11.2026 12:27:49\nSampling rate\t50 Hz\n\nTime  1 - default sample rate\tF1\tA1\tA2\n"
    "s\tkN\tm/s²\tm/s²\n50 Hz\tMX840 CH 1\tMX840 CH 2\tMX840 CH 3\n"
)
# Campbell's: what the logger is, names, units, and how values were made; in quotes.
TABLE_ORIENTED = (
    '"TOA5","CR6","CR6","1234","Std.09","CPU:rig.CR6","4711","Fast"\n"TIMESTAMP","F1","Acc(1)","Acc(2)"\n'
    '"TS","N","m/s^2","m/s^2"\n"","Smp","Smp","Smp"\n'
)


def _grouped(head: str, separator: str, turned: dict[int, str], quote: str) -> Writer:
    """Digits by threes, in mN and um/s^2."""

    def write(path: Path) -> None:
        t, f, a = rig()
        rows = np.column_stack([t, 1e3 * f, 1e6 * a])
        text = [[f"{quote}{x:,.2f}{quote}".translate(turned) for x in row] for row in rows]
        path.write_text(head + _lines(text, separator), encoding="cp1252")

    return write


def two_sheets(path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book, (t, f, a) = openpyxl.Workbook(), rig()
    book.active.append(["Rig", 3])
    book.active.append(["Rate", 50])
    sheet = book.create_sheet("Data")
    for row in (
        ["Time", "f1", "a1", "a2"],
        ["s", "kN", "g", "g"],
        *np.column_stack([t, f / 1e3, a / GRAVITY]).tolist(),
    ):
        sheet.append(row)
    book.save(path)


# Names of files, and what writes them.
FILES: dict[str, Writer] = {
    "local dates.csv": _text("Datum;F1 [N];A1 [m/s²];A2 [m/s²]\n", ";", _date("%d.%m.%Y %H:%M:%S.")),
    "zone.csv": _text(
        "Timestamp,Force 1 (N),Acc 1 (m/s^2),Acc 2 (m/s^2)\n", ",", _date("%m/%d/%Y %H:%M:%S.", " +0100")
    ),
    "commas.csv": _text(
        "Datum;Zeit;Kraft 1 (N);Beschl 1 (m/s²);Beschl 2 (m/s²)\n", ";", _date("26.11.2026;%H:%M:%S,"), "cp1252",
        comma=True,
    ),
    "above.txt": _text("Rig 3, second floor\nOperator,Smith\nRate,50\n\n\nTime,f1,a1,a2\n", ",", _seconds),
    "brackets.csv": _text(
        "Time (ms),Load cell (kN),Channel 2 (g),Channel 3 (g)\n", ",", lambda t: f"{1000 * t:.0f}", unit=(1e3, GRAVITY)
    ),
    "units.tsv": _text(
        "time\tforce\tacc_1\tacc_2\n[s]\t[kN]\t[m/s²]\t[m/s²]\n", "\t", _seconds, unit=(1e3, 1.0)
    ),
    "rows.csv": _text("Time;Force;Acceleration;\n;Floor 1;Floor 1;Floor 2\ns;N;m/s^2;m/s^2\n", ";", _seconds),
    "wind.csv": gravities_and_millimetres,
    "semicolons.csv": semicolons,
    "tabs.dat": _text("Chronos\tF1\tA1\tA2\n", "\t", _seconds),
    "wide.txt": _text("Time (s)\tf1 (N)\ta1 (m/s²)\ta2 (m/s²)\n", "\t", _seconds, "utf-16-le"),
    "struct.mat": mat_struct, "shaker.uff": universal, "labview.tdms": labview, "sheet.xlsx": excel,
}  # fmt: skip
# More of them, of which reading alone is tried.
LOGGERS: dict[str, Writer] = {
    "logger.lvm": _text(LOGGER_TEXT, "\t", lambda t: "", unit=(1e3, 1.0)),
    "catman.asc": _text(CATMAN, "\t", _comma_seconds, "cp1252", comma=True, unit=(1e3, 1.0)),
    "toa5.dat": _text(TABLE_ORIENTED, ",", _date('"%Y-%m-%d %H:%M:%S.', '"')),
    "thousands.csv": _grouped("Time (s),F 1 (mN),A 1 (um/s^2),A 2 (um/s^2)\n", ",", {}, '"'),
    "points.csv": _grouped("Zeit (s);F 1 (mN);A 1 (um/s^2);A 2 (um/s^2)\n", ";", str.maketrans(",.", ".,"), ""),
    "days.csv": _text("Time,f1,a1,a2\n", ",", lambda t: f"{45000.12345 + t / 86400.0:.10f}"),
    "datenum.csv": _text("Date,f1,a1,a2\n", ",", lambda t: f"{738960.12345 + t / 86400.0:.10f}"),
    "rate.csv": _text("Rig 3\nSample rate [Hz];50\nf1;a1;a2\n", ";", None, comma=True),
    "step.csv": _text("# 600 samples, dt=20 ms\nf1,a1,a2\n", ",", None),
    "two sheets.xlsx": two_sheets,
}
