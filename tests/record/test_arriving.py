"""What has come of a record that is still being measured."""

import os
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from pinn_cli.record.arriving import Arriving
from pinn_cli.record.clock import MeasuredFiles
from pinn_cli.record.files.csv import CsvFormat
from pinn_cli.record.files.mat import MatFormat
from pinn_cli.settings.errors import InputError

WANTED = {"data.acceleration.1": "a"}


def arriving(path: Path, **more) -> Arriving:
    return Arriving(MeasuredFiles((path,), more.pop("format", CsvFormat()), **more), WANTED)


def rows(first: int, stop: int, start: float = 0.0) -> str:
    return "".join(f"{start + 0.1 * (i - first):.6g},{i}.5,other\n" for i in range(first, stop))


def append(path: Path, text: str) -> None:
    with path.open("a", encoding="utf-8") as file:
        file.write(text)


def test_a_line_that_is_still_being_written_is_not_read(tmp_path):
    """3.5 cut off is 3, a number as good as any."""
    path = tmp_path / "a.csv"
    came = arriving(path)
    append(path, "t,a,note\n" + rows(0, 6) + "0.6,6")
    assert came.read()
    np.testing.assert_array_equal(came.table.columns["a"], np.arange(6) + 0.5)
    assert not came.read()
    append(path, ".5,other\n0.7,7.5,oth")
    assert came.read()
    np.testing.assert_array_equal(came.table.columns["a"], np.arange(7) + 0.5)
    np.testing.assert_allclose(came.time, 0.1 * np.arange(7))


def test_however_it_comes_it_is_the_same(tmp_path):
    whole = "t;a [g];note\ns;g;\n" + "".join(f"{0.1 * i:.3f};{i},25;x\n".replace(".", ",") for i in range(40))
    one, other = tmp_path / "one.csv", tmp_path / "other.csv"
    one.write_text(whole)
    asked = {"data.acceleration.1": "a [g]"}
    at_once, bit_by_bit = (Arriving(MeasuredFiles((p,), CsvFormat()), asked) for p in (one, other))
    at_once.read()
    rng = np.random.default_rng(1)
    cuts = [0, *sorted(rng.integers(90, len(whole), 12).tolist()), len(whole)]
    for first, stop in pairwise(cuts):
        append(other, whole[first:stop])
        bit_by_bit.read()
    for name, values in at_once.table.columns.items():
        np.testing.assert_array_equal(values, bit_by_bit.table.columns[name])
    np.testing.assert_array_equal(at_once.time, bit_by_bit.time)
    assert at_once.table.hints == bit_by_bit.table.hints
    assert at_once.table.columns["a [g]"][3] == 3.25


def test_what_is_forgotten_leaves_the_rest_as_it_was(tmp_path):
    path = tmp_path / "a.csv"
    append(path, "t,a,note\n" + rows(0, 30) + "3.0,wrong,x\n")
    came = arriving(path)
    came.read()
    came.forget_before(0.95)
    np.testing.assert_allclose(came.time[[0, -1]], [1.0, 3.0])
    assert came.table.columns["a"][0] == 10.5
    with pytest.raises(InputError, match="wrong"):
        came.table.numbers("a")


def test_dates_count_from_the_first_and_marks_are_gaps(tmp_path):
    came, path = arriving(tmp_path / "a.csv", missing=-5), tmp_path / "a.csv"
    append(path, "t,a\n" + "".join(f"170000000{i}.5,{i}.5\n" for i in range(6)))
    came.read()
    append(path, "1700000006.5,-5\n1700000007.5,7.5\n")
    came.read()
    np.testing.assert_array_equal(came.clock.time, np.arange(8.0))
    assert np.flatnonzero(np.isnan(came.table.columns["a"])).tolist() == [6]


def test_a_column_that_there_is_not_is_told_at_once(tmp_path):
    append(tmp_path / "a.csv", "t,b,note\n" + rows(0, 6))
    with pytest.raises(InputError, match=r"data.acceleration.1='a'"):
        arriving(tmp_path / "a.csv").read()


def test_a_file_that_begins_anew_is_told(tmp_path):
    path = tmp_path / "a.csv"
    append(path, "t,a,note\n" + rows(0, 30))
    came = arriving(path)
    came.read()
    path.write_text("t,a,note\n" + rows(0, 3))
    with pytest.raises(InputError, match="shorter than it was"):
        came.read()


def test_files_of_a_folder_in_the_order_of_their_names(tmp_path):
    """The clock of the second begins anew, that of the third goes on; what is no record is passed over."""
    came = arriving(tmp_path)
    append(tmp_path / "001.csv", "t,a,note\n" + rows(0, 10, start=5.0))
    (tmp_path / "notes.md").write_text("t,a\n")
    (tmp_path / ".003.csv").write_text("t,a\n")
    assert came.read()
    append(tmp_path / "002.csv", "t,a,note\n" + rows(10, 20))
    append(tmp_path / "003.csv", "t,a,note\n" + rows(20, 30, start=7.0) + "7.99")
    assert came.read()
    np.testing.assert_allclose(came.time, 5.0 + 0.1 * np.arange(30))
    np.testing.assert_array_equal(came.table.columns["a"], np.arange(30) + 0.5)
    (tmp_path / "0025.csv").write_text("t,a,note\n" + rows(0, 9))
    with pytest.raises(InputError, match=r"0025.csv.*order of their names"):
        came.read()


def test_samples_at_a_rate_are_counted_on_from_file_to_file(tmp_path):
    came = arriving(tmp_path, sampling_rate=10.0)
    for number in range(3):
        append(tmp_path / f"{number}.csv", "a\n" + "".join(f"{i}.5\n" for i in range(10 * number, 10 * number + 10)))
        assert came.read()
    np.testing.assert_allclose(came.time, 0.1 * np.arange(30))


def test_a_file_that_is_read_as_a_whole(tmp_path):
    """While it is being written it may not be readable; what stays unreadable is an error."""
    from scipy.io import savemat

    path = tmp_path / "a.mat"
    came = arriving(path, format=MatFormat())

    def save(samples: int) -> None:
        savemat(tmp_path / "new", {"t": 0.1 * np.arange(samples), "a": np.arange(samples) + 0.5}, appendmat=False)
        os.replace(tmp_path / "new", path)

    save(10)
    assert came.read()
    assert not came.read()
    save(15)
    assert came.read()
    np.testing.assert_array_equal(came.table.columns["a"], np.arange(15) + 0.5)
    path.write_bytes(b"half")
    assert not came.read()
    with pytest.raises(InputError, match="a.mat"):
        came.read()
