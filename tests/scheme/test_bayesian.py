"""Bayesian estimation: what is unknown, under which priors, where it starts, and what the estimator is not told."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from small_problems import NONLINEARITIES, measured, small_chain

from pinn_cli.record.measured_data import MeasuredData
from pinn_cli.record.record import Measurements, Record
from pinn_cli.scheme.bayesian import WIDTH, Bayesian
from pinn_cli.scheme.problem import Problem
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.scheme.starts import parameter_starts
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.settings.errors import InputError
from pinn_cli.system.parameters import PRIOR_WIDTH
from pinn_cli.system.priors import Gamma, HalfNormal, LogNormal, Normal


@pytest.fixture(scope="module")
def measurements() -> Measurements:
    return measured(small_chain(), duration=3.0, samples=33)


def posed(measurements: Measurements, nonlinearity: str = "duffing", **settings) -> Problem:
    scheme = Bayesian(**settings)
    return scheme.pose(small_chain(nonlinearity), [scheme.observe(measurements.record)]).alone


def names(problem: Problem) -> list[str]:
    return [parameter.name for parameter in problem.uncertain]


def every(kinds: tuple[str, ...]) -> list[str]:
    return [f"{kind}_{dof}" for kind in kinds for dof in (1, 2, 3)]


@pytest.mark.parametrize(
    ("nonlinearity", "kinds"),
    [
        ("duffing", ("c", "k", "kappa")),
        ("van_der_pol", ("c", "k", "mu")),
        ("power_damping", ("c", "k", "mu")),
        ("linear", ("c", "k")),
    ],
)
def test_by_default_everything_but_the_masses_is_unknown(measurements, nonlinearity, kinds):
    problem = posed(measurements, nonlinearity)
    assert names(problem) == every(kinds)
    assert all(parameter.unknown for parameter in problem.uncertain)
    assert len(problem.priors) == len(problem.uncertain)


@pytest.mark.parametrize(
    ("unknown", "expected"),
    [
        ("*", every(("m", "c", "k", "kappa"))),
        (["k_1", "c_3"], ["c_3", "k_1"]),
        ("kappa_*", every(("kappa",))),
        (["*_2"], ["m_2", "c_2", "k_2", "kappa_2"]),
        (["k_[1-2]", "k_2"], ["k_1", "k_2"]),
    ],
)
def test_names_and_patterns(measurements, unknown, expected):
    problem = posed(measurements, unknown=unknown)
    assert names(problem) == expected
    assert len(problem.priors) == len(expected)


def test_displacement_and_velocity_of_every_dof_are_seen_and_no_acceleration(measurements):
    seen = Bayesian().observe(measurements.record)
    assert seen.sensors("displacement").all()
    assert seen.sensors("velocity").all()
    assert not seen.sensors("acceleration").any()
    np.testing.assert_array_equal(seen.force, measurements.record.force)


@pytest.mark.parametrize("nonlinearity", NONLINEARITIES)
@pytest.mark.parametrize("priors", [{}, {"k": {"kind": "gamma", "mean": 12.0, "std": 6.0}}], ids=["wide", "chosen"])
def test_what_was_prescribed_for_an_unknown_parameter_is_forgotten(measurements, nonlinearity, priors):
    """Of a simulated record the prescribed value is the truth."""
    scheme = Bayesian(unknown=["k_*", "c_*", "m_2"], priors=priors)
    structure = small_chain(nonlinearity)
    elsewhere = {kind: values.clone() for kind, values in structure.parameters.items()}
    elsewhere["k"] *= 7.0
    elsewhere["c"][1] = 3.0
    elsewhere["m"][1] = 55.0
    record = scheme.observe(measurements.record)
    told, other = (scheme.pose(c, [record]).alone for c in (structure, structure.with_parameters(**elsewhere)))
    for kind, values in told.structure.parameters.items():
        np.testing.assert_array_equal(values, other.structure.parameters[kind])
    for a, b in zip(told.uncertain, other.uncertain, strict=True):
        assert vars(a) == vars(b)


def test_the_prescribed_chain_stays_as_it_was(measurements):
    structure = small_chain()
    scheme = Bayesian(unknown="k_2", priors={"k": {"kind": "normal", "mean": 4.0, "std": 1.0}})
    problem = scheme.pose(structure, [scheme.observe(measurements.record)]).alone
    np.testing.assert_array_equal(structure.parameters["k"], [15.0] * 3)
    np.testing.assert_array_equal(problem.structure.parameters["k"], [15.0, 4.0, 15.0])


def test_priors_by_kind_and_by_name(measurements):
    chosen = {
        "k": {"kind": "gamma", "shape": 2.0, "rate": 0.1},
        "c": {"kind": "half_normal", "scale": 5.0},
        "mu": {"kind": "half_normal", "scale": 1.0},  # of another nonlinearity: no matter
        "k_2": {"kind": "log_normal", "median": 15.0, "sigma": 0.5},
        "*_3": {"kind": "normal", "mean": 0.0, "std": 100.0},
        "kappa_3": None,
    }
    priors = {(p.kind, p.index): p.prior for p in posed(measurements, priors=chosen).uncertain}
    given = {place: prior for place, prior in priors.items() if place[0] != "kappa"}
    assert given == {
        ("c", 0): HalfNormal(5.0), ("c", 1): HalfNormal(5.0), ("c", 2): Normal(0.0, 100.0),
        ("k", 0): Gamma(2.0, 0.1), ("k", 1): LogNormal(15.0, 0.5), ("k", 2): Normal(0.0, 100.0),
    }  # fmt: skip
    assert priors["kappa", 2] == Normal(0.0, 100.0)


def test_priors_that_nobody_chose_are_wide_on_the_scale_of_their_start(measurements):
    problem = posed(measurements, positive=["m", "c", "k"])
    record = Bayesian().observe(measurements.record)
    (starts,) = parameter_starts(small_chain(), record, problem.uncertain, {}, most=1)
    for parameter in problem.uncertain:
        width = PRIOR_WIDTH * starts[parameter].scale
        assert parameter.prior == (Normal(0.0, width) if parameter.kind == "kappa" else HalfNormal(width))
    truth = {"m": 10.0, "c": 1.0, "k": 15.0, "kappa": 100.0}
    assert all(truth[parameter.kind] < 2.0 * PRIOR_WIDTH * start.scale for parameter, start in starts.items())


def test_only_what_may_be_negative_may_be_negative(measurements):
    chosen = {"k_1": {"kind": "normal", "mean": 15.0, "std": 5.0}, "kappa_2": {"kind": "gamma", "mean": 90, "std": 30}}
    problem = posed(measurements, priors=chosen, positive=["c", "k"])
    free = {"k_1", "kappa_1", "kappa_3"}
    assert {p.name for p in problem.uncertain if not p.positive} == free


def test_training_works_under_gaussians_that_are_wider_than_a_prior_that_was_chosen(measurements):
    chosen = {
        "k": {"kind": "gamma", "mean": 1e6, "std": 1e5},
        "c_1": {"kind": "log_normal", "median": 1.0, "sigma": 9.0},  # of which the standard deviation is 1e35 medians
    }
    problem = posed(measurements, priors=chosen)
    for parameter in problem.uncertain:
        assert np.isfinite(parameter.prior_std)
        if parameter.kind == "k" or parameter.name == "c_1":
            assert parameter.prior_std >= WIDTH * parameter.prior.std
        else:
            assert parameter.prior_std == pytest.approx(PRIOR_WIDTH * parameter.scale)


def test_starts_scale_with_the_record(measurements):
    """Forces and masses a thousand times larger at the same motion: everything is a thousand times stiffer."""
    record, structure = measurements.record, small_chain()
    heavy = structure.with_parameters(**{**structure.parameters, "m": 1e3 * structure.parameters["m"]})
    scheme = Bayesian()
    weak = scheme.pose(structure, [scheme.observe(record)]).alone
    strong = scheme.pose(heavy, [scheme.observe(replace(record, force=1e3 * record.force))]).alone
    for a, b in zip(weak.uncertain, strong.uncertain, strict=True):
        assert b.prescribed == pytest.approx(1e3 * a.prescribed, rel=1e-3)
        assert b.prior_std == pytest.approx(1e3 * a.prior_std, rel=1e-3)
        assert a.prescribed > 0 or a.kind == "kappa"


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        ({"unknown": ["k_4"]}, "scheme.unknown=k_4"),
        ({"unknown": ["mu_2"]}, "scheme.unknown=mu_2"),
        ({"positive": "k"}, "scheme.positive=k"),
        ({"acceleration_through": "network"}, "scheme.acceleration_through=network"),
        ({"sensors": {"displacement": False}}, "scheme.sensors="),
        ({"sensors": {"strain": True}}, "scheme.sensors.strain=True"),
        ({"unobserved": [4]}, "scheme.unobserved="),
        ({"priors": 3}, "scheme.priors=3"),
        ({"priors": {"k": 15.0}}, "scheme.priors.k=15.0"),
        ({"priors": {"k": {"shape": 2.0}}}, "scheme.priors.k.kind=(missing)"),
        ({"priors": {"k": {"kind": "gama"}}}, "scheme.priors.k.kind=gama"),
        ({"priors": {"k": {"kind": "gamma", "shape": 2.0}}}, "scheme.priors.k="),
        ({"priors": {"k": {"kind": "gamma", "shape": 2.0, "rate": -1.0}}}, "scheme.priors.k.rate=-1.0"),
        ({"priors": {"k": {"kind": "normal", "mean": 2.0, "std": 0}}}, "scheme.priors.k.std=0"),
        ({"priors": {"k": {"kind": "normal", "mean": float("nan"), "std": 1}}}, "scheme.priors.k.mean=nan"),
        ({"priors": {"k_4": {"kind": "half_normal", "scale": 1.0}}}, "scheme.priors.k_4=k_4"),
        ({"priors": {"stiffness": {"kind": "half_normal", "scale": 1.0}}}, "scheme.priors.stiffness=stiffness"),
    ],
)
def test_impossible_settings_are_named(measurements, settings, named):
    with pytest.raises(InputError) as error:
        posed(measurements, **settings)
    assert str(error.value).startswith(named)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("nothing", [[], ""])
def test_nothing_unknown_is_no_problem_of_this_scheme(measurements, nothing):
    with pytest.raises(InputError, match=r"^scheme\.unknown="):
        posed(measurements, unknown=nothing)


def test_a_dof_without_a_sensor_is_named_with_the_scheme_to_take(measurements):
    with pytest.raises(InputError, match=r"^scheme=bayesian: must be a sensor on every DOF.*DOF 2.*state_parameter"):
        posed(measurements, unobserved=[2])


def test_priors_are_for_this_scheme_alone(measurements):
    assert posed(measurements).priors
    for other in (StateParameter(unobserved=[2]), SparseRecovery()):
        assert other.pose(small_chain(), [other.observe(measurements.record)]).alone.priors == ()


def test_accelerometers_alone_are_warned_of(measurements, caplog):
    sensors = {"displacement": False, "velocity": False, "acceleration": True}
    with caplog.at_level(logging.WARNING, "pinn_cli"):
        problem = posed(measurements, sensors=sensors)
        told = [record.getMessage() for record in caplog.records]
        posed(measurements, sensors={**sensors, "velocity": True})
        posed(measurements)
    assert names(problem) == every(("c", "k", "kappa"))
    assert [text.split(" has ")[0] for text in told] == ["DOF 1", "DOF 2", "DOF 3"]
    assert all("accelerometer only" in text and "\n" not in text for text in told)
    assert len(caplog.records) == 3


def from_csv(folder, record: Record, **quantities: tuple[int, ...]) -> Record:
    """The record that someone measured with these sensors, by way of a file."""
    columns = {"t": record.time, "f1": record.force[:, 0]}
    settings = {}
    for quantity, dofs in quantities.items():
        settings[quantity] = {dof: f"{quantity} {dof}" for dof in dofs}
        columns |= {f"{quantity} {dof}": getattr(record, quantity)[:, dof - 1] for dof in dofs}
    pd.DataFrame(columns).to_csv(folder / "rig.csv", index=False)
    return MeasuredData("rig.csv", "t", {1: "f1"}, **settings, base=folder).measure(3).record


ALL = (1, 2, 3)


@pytest.mark.parametrize(
    "sensors",
    [{"displacement": ALL, "velocity": ALL}, {"displacement": ALL}, {"displacement": (1, 3), "velocity": (2,)}],
    ids=["both", "displacement", "mixed"],
)
def test_a_measured_record_with_displacement_or_velocity_on_every_dof(measurements, tmp_path, caplog, sensors):
    record = from_csv(tmp_path, measurements.record, **sensors)
    with caplog.at_level(logging.WARNING, "pinn_cli"):
        problem = Bayesian().pose(small_chain(), [record]).alone
    assert names(problem) == every(("c", "k", "kappa"))
    assert problem.record is record
    assert not caplog.records


def test_a_measured_record_that_leaves_dofs_out_is_told_why_it_cannot_be(measurements, tmp_path):
    record = from_csv(tmp_path, measurements.record, displacement=(2,), velocity=(2,))
    with pytest.raises(InputError, match=r"^scheme=bayesian: .*none on DOFs 1, 3") as error:
        Bayesian().pose(small_chain(), [record])
    assert "\n" not in str(error.value)


def test_a_measured_record_of_accelerations_is_warned_of_where_nothing_else_is(measurements, tmp_path, caplog):
    record = from_csv(tmp_path, measurements.record, acceleration=ALL, displacement=(1,))
    with caplog.at_level(logging.WARNING, "pinn_cli"):
        Bayesian().pose(small_chain(), [record])
    assert [entry.args[0] for entry in caplog.records] == ["2", "3"]
