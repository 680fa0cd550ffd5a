"""State-parameter estimation: which parameters are unknown, where they start, and what the estimator is not told."""

import math
from dataclasses import replace

import numpy as np
import pytest
from refusals import refusal
from small_problems import measured, small_chain

from pinn_cli.record.record import Measurements
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.settings.errors import InputError
from pinn_cli.system.topology import build_partial_structure


@pytest.fixture(scope="module")
def measurements() -> Measurements:
    return measured(small_chain(), duration=3.0, samples=33)


def names(problem, unknown: bool = True) -> list[str]:
    return [p.name for p in problem.uncertain if p.unknown == unknown]


def posed(measurements, nonlinearity: str = "duffing", **settings):
    scheme = StateParameter(**{"unobserved": [2], **settings})
    return scheme.pose(small_chain(nonlinearity), [scheme.observe(measurements.record)]).alone


@pytest.mark.parametrize(
    ("nonlinearity", "unknown", "expected"),
    [
        ("duffing", None, ["k_2", "kappa_2"]),  # the springs at hidden DOFs
        ("power_damping", None, ["k_2", "mu_2"]),
        ("linear", None, ["k_2"]),
        ("duffing", ["k_1", "c_3"], ["c_3", "k_1"]),
        ("duffing", "k_*", ["k_1", "k_2", "k_3"]),
        ("duffing", ["*_3"], ["m_3", "c_3", "k_3", "kappa_3"]),
        ("duffing", ["k_[1-2]", "k_2"], ["k_1", "k_2"]),
    ],
)
def test_what_is_unknown_by_default_and_by_names_and_patterns(measurements, nonlinearity, unknown, expected):
    assert names(posed(measurements, nonlinearity, unknown=unknown)) == expected


def test_all_other_parameters_are_believed(measurements):
    problem = posed(measurements, unknown="k_2", parameter_uncertainty=0.1)
    assert names(problem, unknown=False) == ["c_1", "c_2", "c_3", "k_1", "k_3", "kappa_1", "kappa_2", "kappa_3"]
    assert names(posed(measurements, unknown="k_2", parameter_uncertainty=0.0), unknown=False) == []


def test_what_was_prescribed_for_an_unknown_parameter_is_forgotten(measurements):
    """Of a simulated record the prescribed value is the truth."""
    scheme, structure = StateParameter(unobserved=[2], unknown=["k_*", "c_2"]), small_chain()
    elsewhere = {kind: values.clone() for kind, values in structure.parameters.items()}
    elsewhere["k"] *= 7.0
    elsewhere["c"][1] = 3.0
    record = scheme.observe(measurements.record)
    told, other = (scheme.pose(s, [record]).alone for s in (structure, structure.with_parameters(**elsewhere)))
    np.testing.assert_array_equal(structure.parameters["k"], [15.0] * 3)
    for kind, values in told.structure.parameters.items():
        np.testing.assert_array_equal(values, other.structure.parameters[kind])
    assert [vars(p) for p in told.uncertain] == [vars(p) for p in other.uncertain]
    start = {p.name: p.prescribed for p in told.uncertain}
    assert float(told.structure.parameters["k"][1]) == start["k_2"] != 15.0


def test_starting_values_by_kind_and_by_name(measurements):
    """Of masses and springs a linear chain that is fitted to the record begins there; the others start there."""
    said = {"k": 10.0, "kappa": 75.0, "mu": 1.0, "k_3": 12.0}
    problem = posed(measurements, unknown=["k_*", "kappa_*"], initial=said)
    start = {p.name: p.prescribed for p in problem.uncertain if p.unknown}
    assert [start[f"kappa_{i}"] for i in (1, 2, 3)] == [75.0] * 3
    assert list(start) == ["k_1", "k_2", "k_3", "kappa_1", "kappa_2", "kappa_3"]


def test_where_a_force_is_unknown_what_was_given_is_a_start(measurements):
    force, unforced = measurements.record.force.copy(), measurements.record.unforced.copy()
    force[:, 2], unforced[2] = np.nan, False
    scheme = StateParameter(unobserved=[2], unknown=["k_1", "k_2"], initial={"k": 10.0, "k_2": 12.0})
    problem = scheme.pose(small_chain(), [scheme.observe(replace(measurements.record, force=force, unforced=unforced))])
    starts = [[p.prescribed for p in one.alone.uncertain if p.unknown] for one in problem.starts]
    assert [10.0, 12.0] in starts


def test_starting_values_from_the_record_scale_with_it(measurements):
    """Forces and masses a thousand times larger at the same motion: everything is a thousand times stiffer."""
    record, structure = measurements.record, small_chain()
    heavy = structure.with_parameters(**{**structure.parameters, "m": 1e3 * structure.parameters["m"]})
    stronger = replace(record, force=1000.0 * record.force)
    scheme = StateParameter(unobserved=[2], unknown=["c_*", "k_*", "kappa_*"])
    weak, strong = (scheme.pose(c, [scheme.observe(r)]).alone for c, r in ((structure, record), (heavy, stronger)))
    for a, b in zip(weak.uncertain, strong.uncertain, strict=True):
        # They come from an iterative fit.
        assert (b.prescribed, b.prior_std, b.step) == pytest.approx(
            (1e3 * a.prescribed, 1e3 * a.prior_std, 1e3 * a.step), rel=3e-3
        )
        assert a.prior_std > 0
    assert {p.kind for p in weak.uncertain if p.prescribed == 0.0} == {"kappa"}


def test_kinds_that_may_be_negative(measurements):
    unknown = {p.name: p for p in posed(measurements, positive=["k"]).uncertain if p.unknown}
    assert unknown["kappa_2"].lower == -math.inf
    assert {name: p.positive for name, p in unknown.items()} == {"k_2": True, "kappa_2": False}


def test_a_law_says_which_of_its_parameters_cannot_be_negative(measurements):
    """With stiffness that degrades below nothing a record has solutions that make no sense."""
    joint = {"between": ["a", "b"], "law": "baber_noori"} | dict.fromkeys(("c", "k", "A", "beta", "gamma", "delta_nu"))
    connections = {
        "joint": joint | {"n": 1.0, "delta_eta": None},
        "rest": {"between": ["b", "c"], "law": "linear", "k": 1.0, "c": 1.0},
    }
    structure = build_partial_structure(["a", "b", "c"], {"a": 1.0, "b": 1.0, "c": 1.0}, connections)
    scheme = StateParameter(unobserved=[], unknown=["*_joint"])
    record = scheme.observe(measurements.record)
    free = {p.kind for p in scheme.pose(structure, [record]).alone.uncertain if p.unknown and not p.positive}
    assert free == {"beta", "gamma"}


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"unknown": ["k_4"]}, "scheme.unknown=k_4"),
        ({"unknown": ["stiffness"]}, "scheme.unknown=stiffness"),
        ({"unknown": [2]}, "scheme.unknown=2"),
        ({"unknown": []}, "scheme.unknown=[]"),
        ({"unobserved": [], "unknown": None}, "scheme.unknown=None"),
        ({"initial": {"k": -1.0}}, "scheme.initial.k=-1.0"),
        ({"initial": {"k_2": float("nan")}}, "scheme.initial.k_2=nan"),
        ({"initial": {"k_7": 1.0}}, "scheme.initial.k_7=k_7"),
        ({"initial": {"m": 0.0}, "unknown": "m_2"}, "scheme.initial.m=0.0"),
        ({"positive": "k"}, "scheme.positive=k"),
        ({"prior_width": 0.0}, "scheme.prior_width=0.0"),
        ({"parameter_uncertainty": -1.0}, "scheme.parameter_uncertainty=-1.0"),
    ],
)
def test_impossible_settings_are_named(measurements, settings, named):
    assert refusal(posed, measurements, **settings).startswith(named)


def test_a_parameter_that_no_equation_contains_is_named(measurements):
    force = measurements.record.force.copy()
    force[:, 2] = np.nan
    record = replace(measurements.record, force=force, unforced=np.array([False, True, False]))
    with pytest.raises(InputError, match=r"scheme\.unknown=m_3.*nothing says what it is"):
        StateParameter(unknown="m_3", unknown_force="free").pose(small_chain(), [record])
    StateParameter(unknown="k_3", unknown_force="free").pose(small_chain(), [record])
    # A force that is a process holds the equation, too.
    StateParameter(unknown="m_3").pose(small_chain(), [record])


def test_a_mass_whose_acceleration_jumps_is_named():
    record = measured(small_chain(), "zero_order", duration=3.0, samples=33).record
    with pytest.raises(InputError, match=r"scheme\.unknown=m_1"):
        StateParameter(unknown="m_1").pose(small_chain(), [record])
    StateParameter(unknown="m_2").pose(small_chain(), [record])
