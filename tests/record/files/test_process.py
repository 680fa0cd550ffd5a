"""What a file does to the library that reads it, it does in a process of its own; it is told in one line."""

import importlib
import math
from pathlib import Path

import numpy as np
import pytest
from calls import refusal

from pinn_cli.runs import apart

pytestmark = pytest.mark.apart
CRASHES = "an odd file that is whole; damaged or cut off? its reader crashes"
READER = """
import ctypes, os, sys, time
import numpy as np
from pinn_cli.record.files.file_format import ArrayFormat
from pinn_cli.record.files.variables import Variable


class Odd(ArrayFormat):
    name, suffixes, expected, beginnings = "odd", (".odd",), "an odd file", (b"ODD",)

    def __init__(self, deed):
        self.deed = deed

    def variables(self, path, wanted):
        match self.deed:
            case "crash":
                ctypes.string_at(0)
            case "fill":
                np.ones(2**60, dtype=np.int8)
            case "loop":
                while True:
                    time.sleep(0.01)
            case "leave":
                os._exit(0)
            case "exit":
                sys.exit("no")
            case "lack":
                import nothing_of_this_name
            case "raise":
                raise RuntimeError("one\\ntwo")
        print("a word", flush=True)
        os.write(2, b"another")
        values = np.array([1.5, np.nan, np.inf])
        whole = Variable.of(np.arange(3, dtype=">i2"))
        if self.deed == "tell times":
            at = np.array([0.0, 0.5, 1.0])
            return {f"every {i}": Variable((4 - i,), lambda i=i: at[::i], time=at[::i]) for i in (1, 2)}
        return {"a": Variable.of(values, "g"), "ä\\n": Variable.of(values), "whole": whole}
"""


@pytest.fixture
def read(tmp_path, monkeypatch):
    """Reads a file that does something."""
    (tmp_path / "odd_reader.py").write_text(READER, encoding="utf-8")
    (tmp_path / "rig.odd").write_bytes(b"ODD")
    monkeypatch.syspath_prepend(tmp_path)
    own = importlib.import_module("odd_reader").Odd
    return lambda deed: own(deed).read(Path(tmp_path / "rig.odd"))


def test_numbers_and_names_come_back_as_they_are(read, capfd):
    table = read("nothing")
    assert list(table.columns) == ["a", "ä\n", "whole"]
    np.testing.assert_array_equal(table.columns["a"], [1.5, math.nan, math.inf])
    np.testing.assert_array_equal(table.columns["whole"], [0.0, 1.0, 2.0])
    assert table.columns["a"].flags.writeable
    assert {name: hint.unit for name, hint in table.hints.items()} == {"a": "g"}
    assert capfd.readouterr() == ("", "")


def test_times_come_back_clock_by_clock(read):
    table = read("tell times")
    assert table.time.tolist() == [0.0, 0.5, 1.0]
    np.testing.assert_array_equal(table.columns["every 1"], [0.0, 0.5, 1.0])
    np.testing.assert_array_equal(table.columns["every 2"], [0.0, math.nan, 1.0])


@pytest.mark.parametrize(
    ("deed", "told"),
    [
        ("crash", CRASHES),
        pytest.param("leave", CRASHES, marks=pytest.mark.slow),
        pytest.param("exit", CRASHES, marks=pytest.mark.slow),
        ("loop", "an odd file that is whole; damaged or cut off? it takes more than 2 s to read"),
        ("fill", "a file of at most "),
        ("lack", "a format whose package works; No module named"),
        ("raise", "an odd file that is whole; damaged or cut off? one"),
    ],
)
def test_what_a_file_does_is_told_in_one_line(read, deed, told, monkeypatch, capfd):
    if deed == "loop":
        monkeypatch.setattr(apart, "_SECONDS", 2.0)
        monkeypatch.setattr(apart, "_BUSY", 1)
    assert "must be " + told in refusal(read, deed)
    assert capfd.readouterr() == ("", "")
