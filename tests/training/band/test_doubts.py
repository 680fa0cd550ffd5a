"""What a model lacks is named, sized and located; a right model lacks nothing."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from lacking_records import high_passed, moved, posed, recorded
from small_problems import measured as small_record
from small_problems import small_chain

from pinn_cli.network.spline import Spline
from pinn_cli.record.record import Record
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.estimate import Doubt, Estimate, RunContext
from pinn_cli.training.gauss_newton import GaussNewton

TERMS = {"friction": 300.0, "cubic term": 1.5e8, "quadratic damping": 2e4}
KINDS = {"friction": "friction", "cubic term": "cubic", "quadratic damping": "quadratic"}


def solved(problem: Problem) -> Estimate:
    return GaussNewton().solve(problem, Spline(), RunContext())


@cache
def lacking(ground: bool, connection: int, term: str, seed: int = 1) -> tuple[Doubt, ...]:
    truth = moved(ground, seed, ((KINDS[term], connection, TERMS[term]),))
    return solved(posed(recorded(truth))).doubts


def spoilt(ground: bool, channels: dict[int, np.ndarray]) -> Record:
    return recorded(moved(ground, 1, ()), channels)


@pytest.mark.parametrize("ground", [True, False])
def test_a_right_model_lacks_nothing(ground: bool):
    assert solved(posed(recorded(moved(ground, 1, ())))).doubts == ()


@pytest.mark.parametrize(("ground", "connection", "term"), [(True, 1, "friction"), (False, 0, "cubic term")])
def test_a_term_that_was_left_out_is_named_with_its_connection_and_size(ground: bool, connection: int, term: str):
    first = lacking(ground, connection, term)[0]
    assert (first.kind, first.of) == (term, f"connection {connection + 1}")
    assert first.moves > 1.0
    assert first.value == pytest.approx(TERMS[term], rel=0.15)
    assert first.std < 0.1 * first.value


@pytest.mark.slow
@pytest.mark.parametrize("ground", [True, False])
@pytest.mark.parametrize("connection", [0, 1, 2])
@pytest.mark.parametrize("term", TERMS)
def test_every_term_of_every_connection(ground: bool, connection: int, term: str):
    for seed in (2, 3):
        first = lacking(ground, connection, term, seed)[0]
        assert (first.kind, first.of) == (term, f"connection {connection + 1}")
        assert first.value == pytest.approx(TERMS[term], rel=0.2)


def test_a_tilting_accelerometer_is_named():
    truth = moved(True, 1, ())
    doubt, *_ = solved(posed(spoilt(True, {2: truth.acceleration[:, 2] + 3.0 * truth.displacement[:, 2]}))).doubts
    assert (doubt.kind, doubt.of) == ("tilt", "acceleration of DOF 3")
    assert abs(doubt.value - 3.0) < 4.0 * doubt.std < 1.0


@pytest.mark.parametrize("order", [1, 2])
def test_accelerometers_that_pass_no_slow_motion_are_named(order: int):
    truth = moved(False, 1, ())
    filtered = high_passed(truth.acceleration, 0.3, order)
    doubt, *_ = solved(posed(spoilt(False, dict(enumerate(filtered.T))))).doubts
    assert (doubt.kind, doubt.of) == ("high_pass", "acceleration of all sensors")
    assert 0.15 < doubt.value < 0.6


@pytest.mark.parametrize("ground", [True, False])
def test_a_wrong_mass_is_named(ground: bool):
    doubt, *_ = solved(posed(recorded(moved(ground, 1, ())), m=[9e3, 10.5e3, 8e3])).doubts
    assert (doubt.kind, doubt.of) == ("m", "DOF 2")
    assert doubt.value == pytest.approx(500.0, rel=0.2)


@pytest.mark.slow
def test_sensors_that_nothing_has_reached_are_not_asked():
    """The far end of a long chain, where rounding is what a sensor shows."""
    chain = small_chain("duffing", 50)
    record = small_record(chain, snr_db=30.0, duration=20.0, samples=401).record.keep({"acceleration": range(1, 51)})
    believed = tuple(Parameter(kind, i, v, 0.1 * v) for kind, v in (("k", 15.0), ("c", 1.0)) for i in range(50))
    assert solved(Problem(chain, record, believed)).doubts == ()
