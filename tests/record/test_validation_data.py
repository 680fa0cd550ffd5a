"""Which data the identified system is tried on, what is left for the estimator, and what is refused."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from pinn_cli.record.measured_data import MeasuredData
from pinn_cli.record.validation_data import ValidationData
from pinn_cli.settings.errors import InputError


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    time = 0.1 * np.arange(401)
    columns = {"t": time, "f": np.sin(time), "a1": np.cos(time), "a2": np.cos(2 * time)}
    pd.DataFrame(columns).to_csv("rig.csv", index=False)
    pd.DataFrame({"t": time[:101], "load": 1.0 + time[:101], "b1": np.sin(3 * time[:101])}).to_csv("b.csv", index=False)
    return tmp_path


def data(validation, **settings) -> MeasuredData:
    return MeasuredData("rig.csv", force={1: "f"}, acceleration={1: "a1", 2: "a2"}, validation=validation, **settings)


def read(validation, **settings):
    held = ValidationData.among([data(validation, **settings)])
    seen = [each.measure(2).record for each in held.seen]
    return seen[0], held.read(seen, 2)


def test_the_file_s_end_is_taken_from_the_estimator(folder):
    seen, found = read({"start": 30.0})
    assert seen.time[[0, -1]] == pytest.approx([0.0, 29.9])
    assert found.record.time[-1] == pytest.approx(40.0)
    assert found.record.time[found.first] == pytest.approx(30.0)
    # It begins where the estimate is well away from its end.
    assert found.record.time[0] == seen.time[found.begins]
    assert 28.0 < found.record.time[0] < 29.9
    np.testing.assert_allclose(found.record.acceleration[:, 0], np.cos(found.record.time))


def test_the_file_s_beginning_is_taken_from_the_estimator(folder):
    seen, found = read({"stop": 10.0})
    assert seen.time[[0, -1]] == pytest.approx([10.1, 40.0])
    assert found.begins is None
    assert found.first == 0
    assert found.record.time[[0, -1]] == pytest.approx([0.0, 10.0])


def test_windows_that_the_user_gives_stay(folder):
    seen, found = read({"start": 30.0, "stop": 35.0, "settle": 1.0}, stop=20.0)
    assert seen.time[-1] == pytest.approx(20.0)
    assert found.record.time[[found.first, -1]] == pytest.approx([31.0, 35.0])
    assert found.record.time[0] < 20.0  # the force in between is followed


@pytest.mark.parametrize(
    ("validation", "settings"),
    [
        ({"start": 10.0, "stop": 15.0}, {"start": 0.0, "stop": 20.0}),
        ({"start": 15.0}, {"stop": 20.0}),
        ({"decimate": 2}, {}),
    ],
)
def test_what_the_estimator_sees_is_no_validation(folder, validation, settings):
    with pytest.raises(InputError, match=r"data\.validation\.start.*outside of what the estimator sees"):
        read(validation, **settings)


def test_another_record_begins_at_rest(folder):
    seen, found = read({"path": "b.csv", "force": {1: "load"}, "acceleration": {2: "b1"}, "settle": 2.0}, holdout=[2])
    assert len(seen.time) == 401
    assert not seen.sensors("acceleration")[1]  # held out of the estimator, not of the validation
    assert found.begins is None
    assert found.record.time[found.first] == pytest.approx(2.0)
    assert found.record.sensors("acceleration").tolist() == [False, True]
    np.testing.assert_allclose(found.record.force[:, 0], 1.0 + found.record.time)


@pytest.mark.parametrize(
    ("validation", "setting", "allowed"),
    [
        ("b.csv", "data.validation", "a segment"),
        ({}, "data.validation", "a segment"),
        ({"pth": "b.csv"}, "data.validation.pth", "path"),
        ({"holdout": [1]}, "data.validation.holdout", "one of the settings"),
        ({"start": 30.0, "settle": -1.0}, "data.validation.settle", ">= 0"),
        ({"start": 30.0, "settle": 9.5}, "data.validation.settle", "leaving 16 samples"),
        ({"start": 39.9}, "data.validation.start, data.validation.stop", "at least 16 samples"),
        ({"path": "c.csv"}, "data.validation.path", "exist"),
        ({"path": "b.csv", "force": {1: "load"}}, "data.validation.acceleration.1", "column"),
        ({"path": "b.csv", "force": {1: None}, "acceleration": {1: "b1"}}, "data.validation", "forces are all"),
    ],
)
def test_what_is_refused(folder, validation, setting, allowed):
    with pytest.raises(InputError) as refused:
        read(validation)
    assert refused.value.setting == setting
    assert allowed in str(refused.value)


def among(validation, *records):
    """What the estimator is left of several records, and the data that the system is tried on."""
    held = ValidationData.among([replace(data(validation), **own) for own in records])
    return held, [each.measure(2).record for each in held.seen]


def test_a_segment_of_the_file_of_one_of_several_records(folder):
    first = {"path": "b.csv", "force": {1: "load"}, "acceleration": {2: "b1"}}
    held, seen = among({"path": "rig.csv", "start": 30.0}, first, {})
    found = held.read(seen, 2)
    assert [record.time[-1] for record in seen] == pytest.approx([10.0, 29.9])
    assert found.of == 1
    assert found.record.time[0] == seen[1].time[found.begins]
    assert found.record.sensors("acceleration").tolist() == [True, True]  # the columns of the record whose file it is
    held, seen = among({"path": "c.csv", **{n: v for n, v in first.items() if n != "path"}}, {}, first)
    assert (held.of, held.follows, held.data.acceleration) == (0, False, {2: "b1"})


def test_a_segment_between_two_parts_of_one_file(folder):
    held, seen = among({"start": 12.0, "stop": 18.0}, {"start": 20.0}, {"stop": 5.0}, {"start": 6.0, "stop": 10.0})
    found = held.read(seen, 2)
    assert (found.of, found.begins is not None) == (2, True)  # the force from 10 s on is followed
    assert [record.time[0] for record in seen] == pytest.approx([20.0, 0.0, 6.0])
    with pytest.raises(InputError, match="outside of what the estimator sees"):
        among({"start": 12.0, "stop": 18.0}, {"start": 20.0}, {"start": 6.0, "stop": 15.0})


def test_a_segment_of_nobody_knows_which_file(folder):
    with pytest.raises(InputError, match=r"data\.validation\.path=None: must be the file"):
        among({"start": 30.0}, {}, {"path": "b.csv"})
