"""Sparse recovery: sensors kept, parameters that may move, and the wall between a problem and its truth."""

from __future__ import annotations

import dataclasses
import typing

import numpy as np
import pytest
from small_problems import NONLINEARITIES, measured, small_chain

from pinn_cli.model.knowledge import EndState
from pinn_cli.record.noise import Repeats
from pinn_cli.record.record import Measurements, Truth
from pinn_cli.scheme.problem import Problem
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.scheme.spectral_estimate import SpectralEstimate
from pinn_cli.settings.errors import InputError
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.priors import Prior

QUANTITIES = ("displacement", "velocity", "acceleration")


@pytest.fixture(scope="module")
def measurements() -> Measurements:
    return measured(small_chain(), duration=3.0, samples=33)


def test_accelerometers_on_the_first_dofs_by_default(measurements):
    seen = SparseRecovery().observe(measurements.record)
    np.testing.assert_array_equal(seen.sensors("acceleration"), [True, False, False])
    assert not seen.sensors("displacement").any()
    assert not seen.sensors("velocity").any()
    np.testing.assert_array_equal(seen.force, measurements.record.force)


def test_chosen_sensors_on_chosen_dofs(measurements):
    scheme = SparseRecovery(
        unobserved="every_2nd", sensors={"displacement": True, "velocity": True, "acceleration": False}
    )
    seen = scheme.observe(measurements.record)
    for quantity, expected in zip(QUANTITIES, ([1, 0, 1], [1, 0, 1], [0, 0, 0]), strict=True):
        np.testing.assert_array_equal(seen.sensors(quantity), np.array(expected, bool))


@pytest.mark.parametrize("nonlinearity", NONLINEARITIES)
def test_every_parameter_but_the_masses_is_uncertain(measurements, nonlinearity):
    structure = small_chain(nonlinearity)
    problem = SparseRecovery(parameter_uncertainty=0.2).pose(structure, [measurements.record]).alone
    expected = [(kind, dof) for kind in structure.parameters if kind != "m" for dof in range(3)]
    assert [(p.kind, p.index) for p in problem.uncertain] == expected
    for p in problem.uncertain:
        assert p.prescribed == float(structure.parameters[p.kind][p.index])
        assert p.prior_std == pytest.approx(0.2 * abs(p.prescribed))


def test_the_default_uncertainty(measurements):
    problem = SparseRecovery().pose(small_chain(k=16.0), [measurements.record]).alone
    assert {p.name: p.prior_std for p in problem.uncertain if p.kind == "k"} == pytest.approx(
        {"k_1": 1.2, "k_2": 1.2, "k_3": 1.2}
    )


def test_nothing_is_uncertain_at_zero(measurements):
    assert SparseRecovery(parameter_uncertainty=0.0).pose(small_chain(), [measurements.record]).alone.uncertain == ()


def test_a_parameter_of_zero_stays_zero(measurements):
    problem = SparseRecovery().pose(small_chain(k=0.0), [measurements.record]).alone
    assert {p.kind for p in problem.uncertain} == {"c", "kappa"}


def test_a_negative_parameter_has_a_positive_spread(measurements):
    structure = small_chain("van_der_pol")
    structure = structure.with_parameters(mu=-structure.parameters["mu"])
    spreads = [
        p.prior_std for p in SparseRecovery().pose(structure, [measurements.record]).alone.uncertain if p.kind == "mu"
    ]
    assert spreads == pytest.approx([0.05625] * 3)


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"parameter_uncertainty": -0.1}, "scheme.parameter_uncertainty=-0.1"),
        ({"parameter_uncertainty": float("nan")}, "scheme.parameter_uncertainty=nan"),
        ({"parameter_uncertainty": "little"}, "scheme.parameter_uncertainty=little"),
        ({"acceleration_through": "network"}, "scheme.acceleration_through=network"),
        ({"sensors": {"acceleration": False}}, "scheme.sensors="),
    ],
)
def test_impossible_settings_are_named(settings, named):
    with pytest.raises(InputError) as error:
        SparseRecovery(**settings)
    assert str(error.value).startswith(named)


def test_impossible_dofs_are_named_once_the_record_is_known(measurements):
    with pytest.raises(InputError, match=r"scheme\.unobserved="):
        SparseRecovery(unobserved=[4]).observe(measurements.record)


def test_names_are_counted_from_one():
    assert Parameter("kappa", 3, 100.0, 7.5).name == "kappa_4"


def hints(cls: type) -> dict[str, type]:
    """Types of a dataclass's fields, those included that are imported for type checkers alone."""
    return typing.get_type_hints(cls, localns={"Prior": Prior, "Repeats": Repeats})


def reachable(cls: type, seen: set[type]) -> set[type]:
    """Every dataclass that a field of a dataclass may hold."""
    if cls in seen:
        return seen
    seen.add(cls)
    for hint in hints(cls).values():
        for part in (hint, *typing.get_args(hint)):
            if isinstance(part, type) and dataclasses.is_dataclass(part):
                reachable(part, seen)
    return seen


def test_a_problem_has_no_way_to_the_truth():
    assert {field.name for field in dataclasses.fields(Problem)} == {
        "structure",
        "record",
        "uncertain",
        "acceleration_through",
        "initial_motion",
        "inputs",
        "prior",
        "initial_state",
        "hand_over",
        "turning_points",
        "spectral",
    }
    record = hints(Problem)["record"]
    for kind in (record, EndState, SpectralEstimate):
        assert not {Truth, Measurements} & reachable(kind, set())
    assert not [name for name in dir(record) if "true" in name or "truth" in name]
