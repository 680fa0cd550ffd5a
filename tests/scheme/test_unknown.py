"""State-parameter and Bayesian estimation: what is unknown, under which priors, where it starts, what is not told."""

import logging
import math
from dataclasses import replace

import numpy as np
import pytest
from calls import refusal
from small_problems import measured, small_chain

from pinn_cli.record.record import Measurements
from pinn_cli.scheme.bayesian import GAUSSIAN_WIDTH, Bayesian
from pinn_cli.scheme.problem import Problem
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.scheme.starts import Starts
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.settings.errors import InputError
from pinn_cli.system.parameters import PRIOR_WIDTH
from pinn_cli.system.priors import HalfNormal, Normal
from pinn_cli.system.topology import build_structure


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


@pytest.mark.parametrize(
    "scheme",
    [
        StateParameter(unobserved=[2], unknown=["k_*", "c_*", "m_2"]),
        Bayesian(unknown=["k_*", "c_*", "m_2"]),
        Bayesian(unknown=["k_*", "c_*", "m_2"], priors={"k": {"kind": "gamma", "mean": 12.0, "std": 6.0}}),
    ],
    ids=["state_parameter", "wide priors", "a chosen prior"],
)
def test_what_was_prescribed_for_an_unknown_parameter_is_forgotten(measurements, scheme):
    """Of a simulated record the prescribed value is the truth."""
    structure, record = small_chain(), scheme.observe(measurements.record)
    elsewhere = {kind: values.clone() for kind, values in structure.parameters.items()}
    elsewhere["k"] *= 7.0
    elsewhere["c"][1] = 3.0
    elsewhere["m"][1] = 55.0
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
    structure = build_structure(["a", "b", "c"], {"a": 1.0, "b": 1.0, "c": 1.0}, connections)
    scheme = StateParameter(unobserved=[], unknown=["*_joint"])
    record = scheme.observe(measurements.record)
    free = {p.kind for p in scheme.pose(structure, [record]).alone.uncertain if p.unknown and not p.positive}
    assert free == {"beta", "gamma"}


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


ALL = (1, 2, 3)


def bayesian(measurements: Measurements, nonlinearity: str = "duffing", **settings) -> Problem:
    scheme = Bayesian(**settings)
    return scheme.pose(small_chain(nonlinearity), [scheme.observe(measurements.record)]).alone


@pytest.mark.parametrize(("nonlinearity", "own"), [("duffing", ["kappa"]), ("van_der_pol", ["mu"]), ("linear", [])])
def test_by_default_everything_but_the_masses_is_unknown(measurements, nonlinearity, own):
    problem = bayesian(measurements, nonlinearity)
    assert names(problem) == [f"{kind}_{dof}" for kind in ("c", "k", *own) for dof in ALL]
    assert all(parameter.unknown for parameter in problem.uncertain)
    assert len(problem.priors) == len(problem.uncertain)


def test_displacement_and_velocity_of_every_dof_are_seen_and_no_acceleration(measurements):
    seen = Bayesian().observe(measurements.record)
    assert [seen.sensors(q).all() for q in ("displacement", "velocity", "acceleration")] == [True, True, False]
    assert not seen.sensors("acceleration").any()
    np.testing.assert_array_equal(seen.force, measurements.record.force)


def test_a_prior_that_was_chosen_says_where_a_parameter_starts(measurements):
    structure = small_chain()
    scheme = Bayesian(unknown="k_2", priors={"k": {"kind": "normal", "mean": 4.0, "std": 1.0}})
    problem = scheme.pose(structure, [scheme.observe(measurements.record)]).alone
    np.testing.assert_array_equal(structure.parameters["k"], [15.0] * 3)
    np.testing.assert_array_equal(problem.structure.parameters["k"], [15.0, 4.0, 15.0])
    assert problem.uncertain[0].prior == Normal(4.0, 1.0)


def test_priors_that_nobody_chose_are_wide_on_the_scale_of_their_start(measurements):
    problem = bayesian(measurements, positive=["m", "c", "k"])
    record = Bayesian().observe(measurements.record)
    (starts,) = Starts(small_chain(), [record], problem.uncertain, {}, most=1)
    for parameter in problem.uncertain:
        width = PRIOR_WIDTH * starts[parameter].scale
        assert parameter.prior == (Normal(0.0, width) if parameter.kind == "kappa" else HalfNormal(width))
    truth = {"m": 10.0, "c": 1.0, "k": 15.0, "kappa": 100.0}
    assert all(truth[parameter.kind] < 2.0 * PRIOR_WIDTH * start.scale for parameter, start in starts.items())


def test_only_what_may_be_negative_may_be_negative(measurements):
    chosen = {"k_1": {"kind": "normal", "mean": 15.0, "std": 5.0}, "kappa_2": {"kind": "gamma", "mean": 90, "std": 30}}
    problem = bayesian(measurements, priors=chosen, positive=["c", "k"])
    assert {p.name for p in problem.uncertain if not p.positive} == {"k_1", "kappa_1", "kappa_3"}


def test_training_works_under_gaussians_that_are_wider_than_a_prior_that_was_chosen(measurements):
    chosen = {
        "k": {"kind": "gamma", "mean": 1e6, "std": 1e5},
        "c_1": {"kind": "log_normal", "median": 1.0, "sigma": 9.0},  # of which the standard deviation is 1e35 medians
    }
    for parameter in bayesian(measurements, priors=chosen).uncertain:
        assert np.isfinite(parameter.prior_std)
        if parameter.kind == "k" or parameter.name == "c_1":
            assert parameter.prior_std >= GAUSSIAN_WIDTH * parameter.prior.std
        else:
            assert parameter.prior_std == pytest.approx(PRIOR_WIDTH * parameter.scale)


@pytest.mark.parametrize(
    ("pose", "settings", "named"),
    [
        (posed, {"unknown": ["k_4"]}, "scheme.unknown=k_4"),
        (posed, {"unknown": ["stiffness"]}, "scheme.unknown=stiffness"),
        (posed, {"unknown": [2]}, "scheme.unknown=2"),
        (posed, {"unknown": []}, "scheme.unknown=[]"),
        (posed, {"unobserved": [], "unknown": None}, "scheme.unknown=None"),
        (posed, {"initial": {"k": -1.0}}, "scheme.initial.k=-1.0"),
        (posed, {"initial": {"k_2": float("nan")}}, "scheme.initial.k_2=nan"),
        (posed, {"initial": {"k_7": 1.0}}, "scheme.initial.k_7=k_7"),
        (posed, {"initial": {"m": 0.0}, "unknown": "m_2"}, "scheme.initial.m=0.0"),
        (posed, {"positive": "k"}, "scheme.positive=k"),
        (posed, {"prior_width": 0.0}, "scheme.prior_width=0.0"),
        (posed, {"parameter_uncertainty": -1.0}, "scheme.parameter_uncertainty=-1.0"),
        (bayesian, {"unknown": ["mu_2"]}, "scheme.unknown=mu_2"),
        (bayesian, {"unknown": []}, "scheme.unknown="),
        (bayesian, {"positive": "k"}, "scheme.positive=k"),
        (bayesian, {"acceleration_through": "network"}, "scheme.acceleration_through=network"),
        (bayesian, {"initial_motion": "still"}, "scheme.initial_motion=still"),
        (bayesian, {"unknown_force": "none"}, "scheme.unknown_force=none"),
        (bayesian, {"sensors": {"displacement": False}}, "scheme.sensors="),
        (bayesian, {"unobserved": [4]}, "scheme.unobserved="),
        (bayesian, {"unobserved": [2]}, "scheme=bayesian: must be a sensor on every DOF, and there is none on DOF 2"),
        (bayesian, {"priors": {"stiff": {"kind": "half_normal", "scale": 1.0}}}, "scheme.priors.stiff=stiff"),
    ],
)
def test_impossible_settings_are_named(measurements, pose, settings, named):
    assert refusal(pose, measurements, **settings).startswith(named)


def test_priors_are_for_this_scheme_alone(measurements):
    for other in (StateParameter(unobserved=[2]), SparseRecovery()):
        assert other.pose(small_chain(), [other.observe(measurements.record)]).alone.priors == ()


@pytest.mark.parametrize(
    ("sensors", "warned"),
    [
        ({"displacement": ALL, "velocity": ALL}, []),
        ({"displacement": (1, 3), "velocity": (2,)}, []),
        ({"acceleration": ALL}, ["1", "2", "3"]),
        ({"acceleration": ALL, "displacement": (1,)}, ["2", "3"]),
    ],
    ids=["both", "mixed", "acceleration", "one displacement"],
)
def test_a_measured_record_is_taken_as_it_is_and_dofs_with_an_accelerometer_only_are_warned_of(
    measurements, caplog, sensors, warned
):
    record = replace(measurements.record.keep(sensors), simulated=False)
    with caplog.at_level(logging.WARNING, "pinn_cli"):
        problem = Bayesian().pose(small_chain(), [record]).alone
    assert (len(problem.uncertain), problem.record) == (9, record)
    assert [entry.args[0] for entry in caplog.records] == warned
    assert all("accelerometer only" in entry.getMessage() for entry in caplog.records)


def test_a_measured_record_that_leaves_dofs_out_is_told_what_else_can_be_done(measurements):
    record = replace(measurements.record.keep({"displacement": (2,), "velocity": (2,)}), simulated=False)
    with pytest.raises(InputError, match=r"^scheme=bayesian: .*none on DOFs 1, 3.*state_parameter"):
        Bayesian().pose(small_chain(), [record])
