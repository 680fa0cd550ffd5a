"""Sparse recovery: sensors kept, parameters that may move, and the wall between a problem and its truth."""

import dataclasses
import typing

import numpy as np
import pytest
from small_problems import measured, small_chain

from pinn_cli.model.knowledge import EndState
from pinn_cli.record.record import Measurements, Record, Truth
from pinn_cli.record.response import Repeats
from pinn_cli.scheme.problem import Problem, SpectralEstimate
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.settings.errors import InputError
from pinn_cli.system.connection import Nonlinearity
from pinn_cli.system.priors import Prior
from pinn_cli.system.structure import Structure

QUANTITIES = ("displacement", "velocity", "acceleration")
OTHER_SIGN = small_chain("van_der_pol").with_parameters(mu=-small_chain("van_der_pol").parameters["mu"])


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


@pytest.mark.parametrize(
    ("structure", "uncertainty", "expected"),
    [
        (small_chain(), 0.2, {"c": 0.2, "k": 3.0, "kappa": 20.0}),
        (small_chain(k=16.0), None, {"c": 0.075, "k": 1.2, "kappa": 7.5}),
        (small_chain("linear"), 0.0, {}),
        (small_chain(k=0.0), None, {"c": 0.075, "kappa": 7.5}),  # a parameter of zero stays zero
        (OTHER_SIGN, None, {"c": 0.075, "k": 1.125, "mu": 0.05625}),
    ],
)
def test_every_parameter_but_the_masses_is_uncertain(measurements, structure, uncertainty, expected):
    settings = {} if uncertainty is None else {"parameter_uncertainty": uncertainty}
    problem = SparseRecovery(**settings).pose(structure, [measurements.record]).alone
    assert [(p.kind, p.index) for p in problem.uncertain] == [(kind, dof) for kind in expected for dof in range(3)]
    for p in problem.uncertain:
        assert p.prescribed == float(structure.parameters[p.kind][p.index])
        assert p.prior_std == pytest.approx(expected[p.kind])


def test_impossible_dofs_are_named_once_the_record_is_known(measurements):
    with pytest.raises(InputError, match=r"scheme\.unobserved="):
        SparseRecovery(unobserved=[4]).observe(measurements.record)


def hints(cls: type) -> dict[str, type]:
    """Types of a dataclass's fields, those included that are imported for type checkers alone."""
    return typing.get_type_hints(cls, localns={kind.__name__: kind for kind in (Prior, Repeats, Nonlinearity)})


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
    found = reachable(Problem, set())
    assert {Record, Structure, EndState, SpectralEstimate} <= found
    assert not {Truth, Measurements} & found
    assert not [name for name in dir(Record) if "true" in name or "truth" in name]
