"""Which DOFs have sensors, as a user says it."""

import pytest
from omegaconf import OmegaConf
from refusals import refusal

from pinn_cli.scheme.sensors import has_load_cells, sensor_quantities, unobserved_dofs
from pinn_cli.settings.errors import InputError


@pytest.mark.parametrize(
    ("ndof", "fraction", "unobserved", "hidden"),
    [
        (6, 0.67, None, [3, 4, 5, 6]),  # the last ones
        (6, 0.0, None, []),
        (1, 0.4, None, []),
        (3, 0.34, None, [3]),
        (6, 0.67, "every_2nd", [2, 4, 6]),
        (6, 0.67, "every_4th", [4]),
        (6, 0.67, "every_21st", []),
        (6, 0.67, (4, 2), [2, 4]),
        (6, 0.67, OmegaConf.create([2, 2, 4]), [2, 4]),
        (6, 0.67, [], []),
    ],
)
def test_a_fraction_a_pattern_or_a_list_hides_dofs(ndof, fraction, unobserved, hidden):
    assert unobserved_dofs(ndof, fraction, unobserved) == hidden


@pytest.mark.parametrize(
    ("fraction", "unobserved", "told"),
    [(x, None, "unobserved_fraction=.* from 0 to below 1") for x in (-0.1, 1.0, float("nan"), "half", None, True)]
    + [(0.95, None, "unobserved_fraction=0.95: .* rounds to all of them")]
    + [(0.67, x, "unobserved=.*every_2nd") for x in ("every_1st", "every_2", "every_second", "", "xevery_2nd")]
    + [(0.67, x, "unobserved=.*DOFs from 1 to 6; DOFs are counted from 1") for x in ([0], [7], [1.5], ["2"], [True])]
    + [(0.67, [3, 1, 2, 6, 5, 4], "unobserved=.*fewer than all 6 DOFs")],
)
def test_what_hides_no_dofs_is_refused(fraction, unobserved, told):
    with pytest.raises(InputError, match=rf"^scheme\.{told}"):
        unobserved_dofs(6, fraction, unobserved)


def test_quantities_come_in_the_records_order():
    sensors = {"acceleration": True, "velocity": False, "displacement": True}
    assert sensor_quantities(sensors) == ("displacement", "acceleration")
    assert sensor_quantities({"velocity": True, "force": False}) == ("velocity",)
    assert has_load_cells({"velocity": True})
    assert not has_load_cells({"velocity": True, "force": False})


@pytest.mark.parametrize(
    ("sensors", "told"),
    [
        ({"jerk": True}, ".jerk=True"),
        ({"force": 1}, ".force=1"),
        ({"velocity": None}, ".velocity=None"),
        ({}, "={}: must be at least one of displacement, velocity, acceleration"),
        ({"acceleration": False}, "={'acceleration': False}: must be at least one of"),
    ],
)
def test_impossible_sensors_are_named(sensors, told):
    assert refusal(sensor_quantities, sensors).startswith(f"scheme.sensors{told}")
