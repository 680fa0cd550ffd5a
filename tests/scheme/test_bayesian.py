"""Bayesian estimation: what is unknown, under which priors, where it starts, and what the estimator is not told."""

import logging
from dataclasses import replace

import numpy as np
import pytest
from refusals import refusal
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

ALL = (1, 2, 3)


@pytest.fixture(scope="module")
def measurements() -> Measurements:
    return measured(small_chain(), duration=3.0, samples=33)


def posed(measurements: Measurements, nonlinearity: str = "duffing", **settings) -> Problem:
    scheme = Bayesian(**settings)
    return scheme.pose(small_chain(nonlinearity), [scheme.observe(measurements.record)]).alone


def names(problem: Problem) -> list[str]:
    return [parameter.name for parameter in problem.uncertain]


@pytest.mark.parametrize(("nonlinearity", "own"), [("duffing", ["kappa"]), ("van_der_pol", ["mu"]), ("linear", [])])
def test_by_default_everything_but_the_masses_is_unknown(measurements, nonlinearity, own):
    problem = posed(measurements, nonlinearity)
    assert names(problem) == [f"{kind}_{dof}" for kind in ("c", "k", *own) for dof in ALL]
    assert all(parameter.unknown for parameter in problem.uncertain)
    assert len(problem.priors) == len(problem.uncertain)


def test_displacement_and_velocity_of_every_dof_are_seen_and_no_acceleration(measurements):
    seen = Bayesian().observe(measurements.record)
    assert [seen.sensors(q).all() for q in ("displacement", "velocity", "acceleration")] == [True, True, False]
    assert not seen.sensors("acceleration").any()
    np.testing.assert_array_equal(seen.force, measurements.record.force)


@pytest.mark.parametrize("priors", [{}, {"k": {"kind": "gamma", "mean": 12.0, "std": 6.0}}], ids=["wide", "chosen"])
def test_what_was_prescribed_for_an_unknown_parameter_is_forgotten(measurements, priors):
    """Of a simulated record the prescribed value is the truth."""
    scheme = Bayesian(unknown=["k_*", "c_*", "m_2"], priors=priors)
    structure, record = small_chain(), scheme.observe(measurements.record)
    elsewhere = {kind: values.clone() for kind, values in structure.parameters.items()}
    elsewhere["k"] *= 7.0
    elsewhere["c"][1] = 3.0
    elsewhere["m"][1] = 55.0
    told, other = (scheme.pose(c, [record]).alone for c in (structure, structure.with_parameters(**elsewhere)))
    for kind, values in told.structure.parameters.items():
        np.testing.assert_array_equal(values, other.structure.parameters[kind])
    for a, b in zip(told.uncertain, other.uncertain, strict=True):
        assert vars(a) == vars(b)


def test_a_prior_that_was_chosen_says_where_a_parameter_starts(measurements):
    structure = small_chain()
    scheme = Bayesian(unknown="k_2", priors={"k": {"kind": "normal", "mean": 4.0, "std": 1.0}})
    problem = scheme.pose(structure, [scheme.observe(measurements.record)]).alone
    np.testing.assert_array_equal(structure.parameters["k"], [15.0] * 3)
    np.testing.assert_array_equal(problem.structure.parameters["k"], [15.0, 4.0, 15.0])
    assert problem.uncertain[0].prior == Normal(4.0, 1.0)


def test_priors_that_nobody_chose_are_wide_on_the_scale_of_their_start(measurements):
    problem = posed(measurements, positive=["m", "c", "k"])
    record = Bayesian().observe(measurements.record)
    (starts,) = Starts(small_chain(), [record], problem.uncertain, {}, most=1)
    for parameter in problem.uncertain:
        width = PRIOR_WIDTH * starts[parameter].scale
        assert parameter.prior == (Normal(0.0, width) if parameter.kind == "kappa" else HalfNormal(width))
    truth = {"m": 10.0, "c": 1.0, "k": 15.0, "kappa": 100.0}
    assert all(truth[parameter.kind] < 2.0 * PRIOR_WIDTH * start.scale for parameter, start in starts.items())


def test_only_what_may_be_negative_may_be_negative(measurements):
    chosen = {"k_1": {"kind": "normal", "mean": 15.0, "std": 5.0}, "kappa_2": {"kind": "gamma", "mean": 90, "std": 30}}
    problem = posed(measurements, priors=chosen, positive=["c", "k"])
    assert {p.name for p in problem.uncertain if not p.positive} == {"k_1", "kappa_1", "kappa_3"}


def test_training_works_under_gaussians_that_are_wider_than_a_prior_that_was_chosen(measurements):
    chosen = {
        "k": {"kind": "gamma", "mean": 1e6, "std": 1e5},
        "c_1": {"kind": "log_normal", "median": 1.0, "sigma": 9.0},  # of which the standard deviation is 1e35 medians
    }
    for parameter in posed(measurements, priors=chosen).uncertain:
        assert np.isfinite(parameter.prior_std)
        if parameter.kind == "k" or parameter.name == "c_1":
            assert parameter.prior_std >= GAUSSIAN_WIDTH * parameter.prior.std
        else:
            assert parameter.prior_std == pytest.approx(PRIOR_WIDTH * parameter.scale)


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"unknown": ["mu_2"]}, "scheme.unknown=mu_2"),
        ({"unknown": []}, "scheme.unknown="),
        ({"positive": "k"}, "scheme.positive=k"),
        ({"acceleration_through": "network"}, "scheme.acceleration_through=network"),
        ({"initial_motion": "still"}, "scheme.initial_motion=still"),
        ({"unknown_force": "none"}, "scheme.unknown_force=none"),
        ({"sensors": {"displacement": False}}, "scheme.sensors="),
        ({"unobserved": [4]}, "scheme.unobserved="),
        ({"unobserved": [2]}, "scheme=bayesian: must be a sensor on every DOF, and there is none on DOF 2"),
        ({"priors": {"stiffness": {"kind": "half_normal", "scale": 1.0}}}, "scheme.priors.stiffness=stiffness"),
    ],
)
def test_impossible_settings_are_named(measurements, settings, named):
    assert refusal(posed, measurements, **settings).startswith(named)


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
