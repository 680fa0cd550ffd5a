from dataclasses import replace

import numpy as np
import pytest

from pinn_cli.record.channels import channels
from pinn_cli.record.record import Record
from pinn_cli.settings.errors import InputError

TIME = np.linspace(1.0, 3.0, 41)


def columns(*sensors: int) -> np.ndarray:
    values = np.full((41, 3), np.nan)
    for dof in sensors:
        values[:, dof - 1] = float(dof)
    return values


def record(**changes) -> Record:
    settings = {
        "time": TIME,
        "displacement": columns(),
        "velocity": columns(2),
        "acceleration": columns(1, 2),
        "force": np.nan_to_num(columns(1)),
        "unforced": [False, True, True],
        **changes,
    }
    return Record(**settings)


def test_an_unknown_force_is_no_sensor_and_a_known_zero_is_none_either():
    it = record(force=columns(3), unforced=[False, False, False])
    assert it.sensors("force").tolist() == [False, False, True]


def test_keep_blanks_every_other_response_sensor():
    kept = record().keep({"acceleration": [2, 3]})
    assert kept.sensors("acceleration").tolist() == [False, True, False]
    assert kept.sensors("velocity").tolist() == [False, False, False]
    assert kept.sensors("force").tolist() == [True, False, False]
    assert kept.observed.tolist() == [False, True, False]
    assert record().observed.tolist() == [True, True, False]


def test_keep_leaves_something_and_knows_what_there_is():
    with pytest.raises(InputError, match="no response sensor"):
        record().keep({"velocity": [1]})
    with pytest.raises(ValueError, match="force"):
        record().keep({"force": [1]})
    with pytest.raises(ValueError, match="DOF 4"):
        record().keep({"velocity": [4]})


def test_other_histories_of_channels_take_the_place_of_theirs_and_of_no_others():
    moving = {"support_velocity": np.full((41, 2), 4.0)}
    it = record(ground_acceleration=0.5 * TIME, supports=moving, support_names=("wall", "table"))
    every = channels(it, ("acceleration", "ground_acceleration", "support_velocity"))
    assert [channel.where for channel in every] == ["1", "2", "wall", "table", "0"]
    shown = it.showing(replace(every[i], measured=-every[i].measured) for i in (1, 3, 4))
    np.testing.assert_array_equal(shown.acceleration[0, :2], [1.0, -2.0])
    np.testing.assert_array_equal(shown.supports["support_velocity"][0], [4.0, -4.0])
    np.testing.assert_array_equal(shown.ground_acceleration, -0.5 * TIME)
    np.testing.assert_array_equal(shown.velocity, it.velocity)
    assert (it.acceleration[0, 1], it.supports["support_velocity"][0, 1]) == (2.0, 4.0)


def half_filled() -> np.ndarray:
    values = columns(1)
    values[3, 0] = np.nan
    return values


@pytest.mark.parametrize(
    ("what", "changes"),
    [
        ("time", {"time": TIME[:10], "velocity": columns(2)[:10]}),
        ("step", {"time": np.append(TIME[:-1], 3.01)}),
        ("grow", {"time": TIME[::-1]}),
        ("finite", {"time": np.append(TIME[:-1], np.nan)}),
        ("velocity has shape", {"velocity": columns(2)[:, :2]}),
        ("velocity has shape", {"velocity": columns(2)[:-1]}),
        ("acceleration must be finite throughout", {"acceleration": half_filled()}),
        ("unforced DOF must be 0", {"force": columns(1, 2, 3)}),
        ("intersample", {"intersample": "linear"}),
        ("no response sensor", {"velocity": columns(), "acceleration": columns()}),
    ],
)
def test_contradictions_are_refused(what, changes):
    with pytest.raises(ValueError, match=what):
        record(**changes)


def test_clock_times_since_1970_pass():
    assert record(time=1.7e9 + 0.001 * np.arange(41)).step == pytest.approx(0.001, rel=1e-4)
