"""Which DOFs have sensors, as a user says it."""

from __future__ import annotations

import pytest
from omegaconf import OmegaConf

from pinn_cli.scheme.sensors import has_load_cells, sensor_quantities, unobserved_dofs
from pinn_cli.settings.errors import InputError


@pytest.mark.parametrize(
    ("ndof", "fraction", "hidden"),
    [(6, 0.67, [3, 4, 5, 6]), (6, 0.0, []), (20, 0.9, list(range(3, 21))), (1, 0.4, []), (3, 0.34, [3])],
)
def test_a_fraction_hides_the_last_dofs(ndof, fraction, hidden):
    assert unobserved_dofs(ndof, fraction, None) == hidden


@pytest.mark.parametrize(
    ("pattern", "hidden"),
    [("every_2nd", [2, 4, 6]), ("every_3rd", [3, 6]), ("every_4th", [4]), ("every_21st", [])],
)
def test_a_pattern_hides_dofs_in_between(pattern, hidden):
    assert unobserved_dofs(6, 0.67, pattern) == hidden


@pytest.mark.parametrize("given", [[4, 2], (2, 4), [2, 2, 4], OmegaConf.create([2, 4])])
def test_a_list_hides_those_dofs(given):
    assert unobserved_dofs(6, 0.67, given) == [2, 4]


def test_an_empty_list_hides_nothing():
    assert unobserved_dofs(6, 0.67, []) == []


@pytest.mark.parametrize("fraction", [-0.1, 1.0, 1.5, float("nan"), float("inf"), "half", None, True])
def test_an_impossible_fraction(fraction):
    with pytest.raises(InputError, match=r"scheme\.unobserved_fraction=.* from 0 to below 1"):
        unobserved_dofs(6, fraction, None)


def test_a_fraction_that_hides_all():
    with pytest.raises(InputError, match=r"scheme\.unobserved_fraction=0\.95: .* rounds to all of them"):
        unobserved_dofs(6, 0.95, None)


@pytest.mark.parametrize(
    "pattern", ["every_1st", "every_0th", "every_2", "every_second", "odd", "", "xevery_2nd", "every_2nds"]
)
def test_an_impossible_pattern(pattern):
    with pytest.raises(InputError, match=r"scheme\.unobserved=.*every_2nd"):
        unobserved_dofs(6, 0.67, pattern)


@pytest.mark.parametrize("dofs", [[0], [7], [1.5], ["2"], [True], [None], [2, -1]])
def test_dofs_that_do_not_exist(dofs):
    with pytest.raises(InputError, match=r"scheme\.unobserved=.*DOFs from 1 to 6; DOFs are counted from 1"):
        unobserved_dofs(6, 0.67, dofs)


def test_a_list_that_hides_all():
    with pytest.raises(InputError, match=r"scheme\.unobserved=.*fewer than all 3 DOFs"):
        unobserved_dofs(3, 0.67, [3, 1, 2])


def test_quantities_come_in_the_records_order():
    assert sensor_quantities({"acceleration": True, "velocity": False, "displacement": True}) == (
        "displacement",
        "acceleration",
    )
    assert (
        sensor_quantities({"velocity": True}) == sensor_quantities({"velocity": True, "force": False}) == ("velocity",)
    )
    assert has_load_cells({"velocity": True})
    assert not has_load_cells({"velocity": True, "force": False})


@pytest.mark.parametrize(
    "sensors", [{"jerk": True}, {"force": 1}, {"velocity": "yes"}, {"velocity": 1}, {"velocity": None}]
)
def test_an_impossible_sensor(sensors):
    with pytest.raises(InputError, match=rf"scheme\.sensors\.{next(iter(sensors))}="):
        sensor_quantities(sensors)


@pytest.mark.parametrize("sensors", [{}, {"acceleration": False}])
def test_no_sensor_at_all(sensors):
    with pytest.raises(InputError, match=r"scheme\.sensors=.*at least one of displacement, velocity, acceleration"):
        sensor_quantities(sensors)
