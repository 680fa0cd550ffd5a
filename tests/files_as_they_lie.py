"""Records as programs of measurement leave them: twelve files of one rig of two storeys, and more."""

from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from functools import cache
from pathlib import Path

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


def _lines(rows: Sequence[Sequence[object]], separator: str) -> str:
    return "".join(separator.join(map(str, row)) + "\n" for row in rows)


def _rows(times: Sequence[object], comma: bool = False, unit: tuple[float, float] = (1.0, 1.0)) -> list[list[str]]:
    _, f, a = rig()
    columns = np.column_stack([f / unit[0], a / unit[1]])
    return [[str(t), *(f"{x:.6g}".replace(".", ",") if comma else f"{x:.6g}" for x in row)]
            for t, row in zip(times, columns, strict=True)]  # fmt: skip


def _dates(pattern: str) -> list[str]:
    moments = [BEGIN + timedelta(seconds=float(t)) for t in rig()[0]]
    return [f"{one.strftime(pattern)}{one.microsecond // 1000:03d}" for one in moments]


def _seconds() -> list[str]:
    return [f"{t:.2f}" for t in rig()[0]]


def local_dates(path: Path) -> None:
    path.write_text("Datum;F1 [N];A1 [m/s²];A2 [m/s²]\n" + _lines(_rows(_dates("%d.%m.%Y %H:%M:%S.")), ";"))


def dates_with_zone(path: Path) -> None:
    rows = _rows([f"{date} +0100" for date in _dates("%m/%d/%Y %H:%M:%S.")])
    path.write_text("Timestamp,Force 1 (N),Acc 1 (m/s^2),Acc 2 (m/s^2)\n" + _lines(rows, ","))


def decimal_commas(path: Path) -> None:
    rows = [["26.11.2026", *row] for row in _rows(_dates("%H:%M:%S,"), comma=True)]
    path.write_text("Datum;Zeit;Kraft 1 (N);Beschl 1 (m/s²);Beschl 2 (m/s²)\n" + _lines(rows, ";"), encoding="cp1252")


def lines_above(path: Path) -> None:
    above = "Rig 3, second floor\nOperator,Smith\nRate,50\n\n\n"
    path.write_text(above + "Time,f1,a1,a2\n" + _lines(_rows(_seconds()), ","))


def units_in_brackets(path: Path) -> None:
    rows = _rows([f"{1000 * t:.0f}" for t in rig()[0]], unit=(1e3, GRAVITY))
    path.write_text("Time (ms),Load cell (kN),Channel 2 (g),Channel 3 (g)\n" + _lines(rows, ","))


def unit_row(path: Path) -> None:
    rows = _rows(_seconds(), unit=(1e3, 1.0))
    path.write_text("time\tforce\tacc_1\tacc_2\n[s]\t[kN]\t[m/s²]\t[m/s²]\n" + _lines(rows, "\t"), encoding="utf-8")


def two_header_rows(path: Path) -> None:
    head = "Time;Force;Acceleration;\n;Floor 1;Floor 1;Floor 2\ns;N;m/s^2;m/s^2\n"
    path.write_text(head + _lines(_rows(_seconds()), ";"))


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
    rows = _rows([time.replace(".", ",") for time in _seconds()], comma=True)
    path.write_text("Zeit;F1;A1;A2;\n" + "".join(";".join(row) + ";\n" for row in rows))


def tabs(path: Path) -> None:
    path.write_text("Chronos\tF1\tA1\tA2\n" + _lines(_rows(_seconds()), "\t"))


def utf_16(path: Path) -> None:
    text = "Time (s)\tf1 (N)\ta1 (m/s²)\ta2 (m/s²)\n" + _lines(_rows(_seconds()), "\t")
    path.write_bytes(text.encode("utf-16-le"))


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


def logger_text(path: Path) -> None:
    """LabVIEW's: two headers, units and the step in the second one, and a name of comments that no row has."""
    told = "LabVIEW Measurement\nSeparator\tTab\nTime\t12:27:49.01\n***End_of_Header***\t\n\t\t\t\t\nChannels\t3\n"
    told += "Samples\t600\t600\t600\t\nY_Unit_Label\tkN\tm/s^2\tm/s^2\t\nX0\t0.0E+0\t0.0E+0\t0.0E+0\t\n"
    told += "Delta_X\t0.020000\t0.020000\t0.020000\t\n***End_of_Header***\t\t\t\t\n"
    path.write_text(told + "X_Value\tF1\tA1\tA2\tComment\n" + _lines(_rows([""] * SAMPLES, unit=(1e3, 1.0)), "\t"))


def catman(path: Path) -> None:
    head = (
        "catman AP\t5.4.1\nT0\t26.11.2026 12:27:49\nSampling rate\t50 Hz\n\nTime  1 - default sample rate\tF1\tA1\tA2\n"
    )
    head += "s\tkN\tm/s²\tm/s²\n50 Hz\tMX840 CH 1\tMX840 CH 2\tMX840 CH 3\n"
    rows = _rows([time.replace(".", ",") for time in _seconds()], comma=True, unit=(1e3, 1.0))
    path.write_text(head + _lines(rows, "\t"), encoding="cp1252")


def table_oriented(path: Path) -> None:
    """Campbell's: what the logger is, names, units, and how values were made; in quotes."""
    head = '"TOA5","CR6","CR6","1234","Std.09","CPU:rig.CR6","4711","Fast"\n"TIMESTAMP","F1","Acc(1)","Acc(2)"\n'
    head += '"TS","N","m/s^2","m/s^2"\n"","Smp","Smp","Smp"\n'
    path.write_text(head + _lines(_rows([f'"{date}"' for date in _dates("%Y-%m-%d %H:%M:%S.")]), ","))


def _grouped(path: Path, head: str, separator: str, turned: dict[int, str], quote: str) -> None:
    """Digits by threes, in mN and um/s^2."""
    t, f, a = rig()
    rows = np.column_stack([t, 1e3 * f, 1e6 * a])
    text = [[f"{quote}{x:,.2f}{quote}".translate(turned) for x in row] for row in rows]
    path.write_text(head + _lines(text, separator), encoding="cp1252")


def thousands(path: Path) -> None:
    _grouped(path, "Time (s),F 1 (mN),A 1 (um/s^2),A 2 (um/s^2)\n", ",", {}, '"')


def thousands_with_points(path: Path) -> None:
    _grouped(path, "Zeit (s);F 1 (mN);A 1 (um/s^2);A 2 (um/s^2)\n", ";", str.maketrans(",.", ".,"), "")


def day_numbers(path: Path) -> None:
    rows = _rows([f"{45000.12345 + t / 86400.0:.10f}" for t in rig()[0]])
    path.write_text("Time,f1,a1,a2\n" + _lines(rows, ","))


def numbered_days(path: Path) -> None:
    rows = _rows([f"{738960.12345 + t / 86400.0:.10f}" for t in rig()[0]])
    path.write_text("Date,f1,a1,a2\n" + _lines(rows, ","))


def rate_above(path: Path) -> None:
    path.write_text(
        "Rig 3\nSample rate [Hz];50\nf1;a1;a2\n" + _lines([row[1:] for row in _rows(_seconds(), True)], ";")
    )


def step_above(path: Path) -> None:
    path.write_text("# 600 samples, dt=20 ms\nf1,a1,a2\n" + _lines([row[1:] for row in _rows(_seconds())], ","))


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


Writer = Callable[[Path], None]
# Names of files, and what writes them.
FILES: dict[str, Writer] = {
    "local dates.csv": local_dates, "zone.csv": dates_with_zone, "commas.csv": decimal_commas, "above.txt": lines_above,
    "brackets.csv": units_in_brackets, "units.tsv": unit_row, "rows.csv": two_header_rows,
    "wind.csv": gravities_and_millimetres, "semicolons.csv": semicolons, "tabs.dat": tabs, "wide.txt": utf_16,
    "struct.mat": mat_struct, "shaker.uff": universal, "labview.tdms": labview, "sheet.xlsx": excel,
}  # fmt: skip
# More of them, of which reading alone is tried.
LOGGERS: dict[str, Writer] = {
    "logger.lvm": logger_text, "catman.asc": catman, "toa5.dat": table_oriented, "thousands.csv": thousands,
    "points.csv": thousands_with_points, "days.csv": day_numbers, "datenum.csv": numbered_days, "rate.csv": rate_above,
    "step.csv": step_above, "two sheets.xlsx": two_sheets,
}  # fmt: skip
