"""Files as programs of measurement leave them: names, units and times are found wherever they stand."""

import numpy as np
import pytest
from calls import refusal
from files_as_they_lie import FILES, GRAVITY, LOGGERS, RATE, SAMPLES, rig

from pinn_cli.record.clock import MeasuredFiles, recognised
from pinn_cli.record.files.csv import CsvFormat
from pinn_cli.record.files.excel import ExcelFormat
from pinn_cli.record.files.table import first_other, mark, seconds_of

# Names and units of force and accelerations.
COLUMNS = {
    "local dates.csv": {"F1 [N]": "N", "A1 [m/s²]": "m/s^2", "A2 [m/s²]": "m/s^2"},
    "zone.csv": {"Force 1 (N)": "N", "Acc 1 (m/s^2)": "m/s^2", "Acc 2 (m/s^2)": "m/s^2"},
    "commas.csv": {"Kraft 1 (N)": "N", "Beschl 1 (m/s²)": "m/s^2", "Beschl 2 (m/s²)": "m/s^2"},
    "above.txt": {"f1": "", "a1": "", "a2": ""},
    "brackets.csv": {"Load cell (kN)": "kN", "Channel 2 (g)": "g", "Channel 3 (g)": "g"},
    "units.tsv": {"force": "kN", "acc_1": "m/s^2", "acc_2": "m/s^2"},
    "rows.csv": {"Force Floor 1": "N", "Acceleration Floor 1": "m/s^2", "Acceleration Floor 2": "m/s^2"},
    "semicolons.csv": {"F1": "", "A1": "", "A2": ""},
    "wide.txt": {"f1 (N)": "N", "a1 (m/s²)": "m/s^2", "a2 (m/s²)": "m/s^2"},
    "struct.mat": {"rig.force": "", "rig.acc.1": "", "rig.acc.2": ""},
    "shaker.uff": {"force 1:+Z": "N", "acceleration 1:+Z": "m/s^2", "acceleration 2:+Z": "m/s^2"},
    "labview.tdms": {"Untitled/cDAQ1Mod1/ai0": "N", "Untitled/cDAQ1Mod2/ai0": "g", "Untitled/cDAQ1Mod2/ai1": "g"},
    "sheet.xlsx": {"Force 1 (kN)": "kN", "Acc 1 (g)": "g", "Acc 2 (g)": "g"},
    "logger.lvm": {"F1": "kN", "A1": "m/s^2", "A2": "m/s^2"},
    "catman.asc": {"F1": "kN", "A1": "m/s^2", "A2": "m/s^2"},
    "toa5.dat": {"F1": "N", "Acc(1)": "m/s^2", "Acc(2)": "m/s^2"},
    "thousands.csv": {"F 1 (mN)": "mN", "A 1 (um/s^2)": "um/s^2", "A 2 (um/s^2)": "um/s^2"},
    "points.csv": {"F 1 (mN)": "mN", "A 1 (um/s^2)": "um/s^2", "A 2 (um/s^2)": "um/s^2"},
    "days.csv": {"f1": "", "a1": "", "a2": ""},
    "datenum.csv": {"f1": "", "a1": "", "a2": ""},
    "rate.csv": {"f1": "", "a1": "", "a2": ""},
    "step.csv": {"f1": "", "a1": "", "a2": ""},
    "two sheets.xlsx": {"f1": "kN", "a1": "g", "a2": "g"},
}
FACTORS = {"kN": 1e3, "mN": 1e-3, "um/s^2": 1e-6, "g": GRAVITY}


@pytest.mark.parametrize("name", COLUMNS)
def test_a_file_is_read_without_a_word(tmp_path, name):
    path = tmp_path / name
    (FILES | LOGGERS)[name](path)
    clock = MeasuredFiles((path,), recognised(path)).read()
    digit = 2e-5 if name in ("days.csv", "datenum.csv") else 1e-9  # of days, as double precision has them
    np.testing.assert_allclose(clock.time - clock.time[0], np.arange(SAMPLES) / RATE, atol=digit)
    _, force, acceleration = rig()
    for (column, unit), values in zip(COLUMNS[name].items(), (force, *acceleration.T), strict=True):
        hint = clock.table.hints.get(column)
        assert (hint.unit if hint else "") == unit
        read = FACTORS.get(unit, 1.0) * clock.table.numbers(column)
        np.testing.assert_allclose(read, values, rtol=1e-5, atol=2e-6 * np.abs(values).max())


@pytest.mark.parametrize(
    ("text", "columns", "first_line"),
    [
        ("My rig\n2026\n\nt,a\n0,1\n1,2\n", ["t", "a"], 5),
        ("Operator,Smith\nRate,50\nGain,2\nt,a\n0,1\n1,2\n", ["t", "a"], 5),
        ("\n\nt,a\ns,g\n0,1\n1,2\n", ["t", "a"], 5),
        ("t,a\nsec,milli-gee\n0,1\n1,2\n", ["t", "a"], 3),
        ("Time,Ch1,Ch2\n,Roof,Floor\n0,1,2\n1,2,3\n", ["Time", "Ch1 Roof", "Ch2 Floor"], 3),
        ("Time;Acc;;Force\n;Roof;Floor;Roof\n0;1;2;3\n", ["Time", "Acc Roof", "Acc Floor", "Force Roof"], 3),
        ("t,1,2\n0,1,2\n1,2,3\n", ["t", "1", "2"], 2),
        ("t,a\n0,1\n1,2\nbroken,off\n3,4\n", ["t", "a"], 2),
    ],
)
def test_where_the_names_are(tmp_path, text, columns, first_line):
    (tmp_path / "rig.csv").write_text(text)
    table = CsvFormat().read(tmp_path / "rig.csv")
    assert (list(table.columns), table.first_line) == (columns, first_line)


def test_units_behind_names(tmp_path):
    (tmp_path / "rig.csv").write_text("Zeit / s;F / kN;a1 / (mm/s²);a 2, g;a/b m\n" + "0;1;2;3;4\n" * 3)
    hints = CsvFormat().read(tmp_path / "rig.csv").hints
    assert {name: hint.unit for name, hint in hints.items()} == {
        "Zeit / s": "s", "F / kN": "kN", "a1 / (mm/s²)": "mm/s^2", "a 2, g": "g",
    }  # fmt: skip


def test_times_told_above_the_names_are_those_of_the_columns_that_are_asked_for(tmp_path):
    LOGGERS["rate.csv"](tmp_path / "rig.csv")
    clock = MeasuredFiles((tmp_path / "rig.csv",), CsvFormat()).read({"data.acceleration.2": "a2"})
    assert list(clock.table.columns) == ["a2"]
    np.testing.assert_allclose(clock.time, np.arange(SAMPLES) / RATE)


@pytest.mark.parametrize("mark", ["---", "#N/A", "NAN", "-", "*****", "n/a", "#DIV/0!", ""])
def test_marks_that_stand_for_no_number_are_gaps(tmp_path, mark):
    (tmp_path / "rig.csv").write_text(f't,a\n0,1\n1,"{mark}"\n2,3\n')
    table = CsvFormat().read(tmp_path / "rig.csv")
    np.testing.assert_array_equal(table.numbers("a"), [1, np.nan, 3])


@pytest.mark.parametrize(
    ("mark", "missing", "gaps"),
    [
        (-9999, None, True), (-999.25, None, True), (9999.9, None, True), (-9999, [], False), (-7999, None, False),
        (-7999, -7999, True), (-7999, [1e6, -7999], True), (2, [2], True), (-999, [1], False),
    ],
)  # fmt: skip
def test_numbers_that_mark_missing_values(tmp_path, caplog, mark, missing, gaps):
    (tmp_path / "rig.csv").write_text("t,a,f\n" + f"0,1.5,-999\n1,{mark},400\n2,{mark},-400\n3,2,500\n4,2.5,-500\n")
    table = MeasuredFiles((tmp_path / "rig.csv",), CsvFormat(), missing=missing).read().table
    seen = np.nan if gaps else mark
    np.testing.assert_array_equal(table.numbers("a"), [1.5, seen, seen, np.nan if mark == 2 else 2, 2.5])
    np.testing.assert_array_equal(table.numbers("f"), [-999, 400, -400, 500, -500])  # near the others
    told = f"rig.csv, column 'a': 2 samples are {mark}, far from all others, and are taken for missing; data.missing=[]"
    assert (told in caplog.text) == (gaps and missing is None)
    assert "data.missing=gap: must be a finite number" in refusal(MeasuredFiles, (), CsvFormat(), missing=[mark, "gap"])


def test_a_number_that_is_no_measurement_by_its_looks():
    random = np.random.default_rng(0)
    values, more = random.normal(size=100), random.normal(size=400)
    assert mark(values) is None
    values[[3, 50]] = -80.0
    assert mark(values) == -80.0
    assert mark(np.append(values, 200.0)) is None  # which tells no more of them
    assert mark(np.repeat([0.0, 5.0], 50)) is mark(np.full(5, np.nan)) is None
    more[10:60] = 0.0  # at rest
    assert mark(more) is mark(np.round(more, 1)) is None
    more[100:400:30] = 0.5
    assert mark(more) == 0.5
    more[100:400:30] = more.max()
    assert mark(more) is None  # clipped


@pytest.mark.parametrize(
    ("cells", "read", "told"),
    [
        (["1,234", "-512", "2,033"], [1234, -512, 2033], False),
        (["9,807", "9,806", "9,811"], [9.807, 9.806, 9.811], True),
        (["9,807", "0,012", "9,811"], [9.807, 0.012, 9.811], False),
        (["9,807", "9,81", "10"], [9.807, 9.81, 10], False),
    ],
)
def test_what_a_comma_is_the_other_numbers_tell(tmp_path, caplog, cells, read, told):
    rows = [f"{i};{cell}\n" for i, cell in enumerate(cells * 4)]
    (tmp_path / "rig.csv").write_text("t;a\n" + "".join(rows))
    table = MeasuredFiles((tmp_path / "rig.csv",), CsvFormat()).read().table
    np.testing.assert_allclose(table.numbers("a"), read * 4)
    assert ("data.format.decimal=." in caplog.text) == told


def test_a_comma_that_may_be_one_of_decimals_groups_no_digits(tmp_path):
    (tmp_path / "rig.csv").write_text("t;a\n" + "0.1;9,807\n0.2;9,806\n" * 3)
    assert "decimals take a point" in refusal(CsvFormat().read(tmp_path / "rig.csv").numbers, "a")
    (tmp_path / "rig.csv").write_text("t;a\n" + "0.1;9,807\n0.2;1,009,806.5\n")
    np.testing.assert_array_equal(CsvFormat().read(tmp_path / "rig.csv").numbers("a"), [9807, 1009806.5])


def test_lines_above_that_nobody_can_tell_apart_are_named(tmp_path):
    (tmp_path / "rig.csv").write_text("t,a\n1,2,3\n4,5,6\n")
    assert "data.format.names_line" in refusal(CsvFormat().read, tmp_path / "rig.csv")
    assert "data.format.names_line" in refusal(CsvFormat(names_line=2).read, tmp_path / "rig.csv", {"data.time": "x"})
    (tmp_path / "rig.csv").write_text("rig\nTime,Ch1\n,Roof\nx,y\n0,1\n1,2\n")
    assert list(CsvFormat(names_line=2).read(tmp_path / "rig.csv").columns) == ["Time", "Ch1 Roof"]


@pytest.mark.parametrize(
    ("texts", "seconds"),
    [
        (["2026-11-26T23:59:59.5", "2026-11-27T00:00:01"], [0, 1.5]),
        (["26.11.2026 23:59:59,5", "27.11.2026 00:00:01,0"], [0, 1.5]),
        (["11/26/2026 11:59:59.5 PM", "11/27/2026 12:00:01 AM"], [0, 1.5]),
        (["3/4/2026 23:59", "4/4/2026 0:01"], [0, 120]),
        (["4/3/2026 23:59", "4/4/2026 0:01"], [0, 120]),
        (["25.10.2026 02:59:59 +0200", "25.10.2026 02:00:00 +0100"], [0, 1]),
        (["26.11.26 10:00:00 CET", "26.11.26 10:00:01 CET"], [0, 1]),
        (["31-Oct-2026 23:59:59.5", "01-Nov-2026 00:00:01.0"], [0, 1.5]),
        (["9 september 2026 10:00:00", "10 September 2026 10:00:01"], [0, 86401]),
        (["9-Sap-2026 10:00:00", "10-Sap-2026 10:00:01"], None),
        (["23:59:59.75", "00:00:00.25", "23:59:59.75"], [0, 0.5, 86400]),
        (["0:00:01", "100:00:01"], [0, 360000]),
        (["25.10.2026 02:59:59 CEST", "25.10.2026 02:00:00 CET"], None),
        (["31.2.2026 10:00", "1.3.2026 10:00"], None),
        (["10:00", "26.11.2026 10:00"], None),
        (["10:00:00", "ten"], None),
    ],
)
def test_dates_and_times_of_day(texts, seconds):
    assert first_other([texts[0], texts[-1], "soon"]) == 2 or seconds is None
    assert first_other(["soon", *texts]) is None
    found = seconds_of(texts)
    assert (found is None) == (seconds is None)
    if seconds is not None:
        np.testing.assert_allclose(found, seconds, atol=1e-9)


def test_excel_has_sheets_and_evaluates_nothing(tmp_path, caplog):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["t", "a"])
    book.active.append([0, "=1+1"])
    book.active.append([1, 2.5])
    book.create_sheet("second").append(["t", "b"])
    book["second"].append([0, 7])
    book.save(tmp_path / "rig.xlsx")
    table = ExcelFormat().read(tmp_path / "rig.xlsx")
    np.testing.assert_array_equal(table.columns["a"], [np.nan, 2.5])  # openpyxl itself has worked out nothing
    assert ExcelFormat(sheet="second").read(tmp_path / "rig.xlsx").columns["b"].tolist() == [7.0]
    assert "data.format.sheet=secnd" in refusal(ExcelFormat(sheet="secnd").read, tmp_path / "rig.xlsx")
    for row in range(20):
        book["second"].append([row + 1, row % 7])
        book.active.append([row + 2, row % 5])
    book.save(tmp_path / "both.xlsx")
    MeasuredFiles((tmp_path / "both.xlsx",), ExcelFormat()).read()
    assert "both.xlsx: the sheet 'Sheet' is read; data.format.sheet=... takes 'second'" in caplog.text
    (tmp_path / "broken.xlsx").write_bytes((tmp_path / "rig.xlsx").read_bytes()[:500])
    assert "damaged or cut off?" in refusal(ExcelFormat().read, tmp_path / "broken.xlsx")
