"""Rows of sensors with a calibration of their own: Jacobian and gradient against finite differences, every kind."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.sparse import csr_matrix
from structures import braced, hysteretic

from pinn_cli.network.spline import Spline
from pinn_cli.record.gauge import GAUGE, Calibration, Gauge
from pinn_cli.record.record import Record
from pinn_cli.scheme.calibration import sensor_parameters
from pinn_cli.scheme.inputs import inputs_of
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.band.inferred import InferenceSettings
from pinn_cli.training.band.normal_equations import NormalEquations
from pinn_cli.training.band.point import Point
from pinn_cli.training.band.starting_noise import starting_noise
from pinn_cli.training.base import built
from pinn_cli.training.history import History
from pinn_cli.training.noise_model import NoiseModel

TIME = 2.0 + 0.3 * np.arange(21)
OWN = np.sort(np.random.default_rng(3).uniform(TIME[0], TIME[-1], 34))
FOUR = {
    "gain": Calibration(1.2, 0.4, unknown=True),
    "offset": Calibration(0.3, 0.7, unknown=True),
    "drift": Calibration(-0.1, 0.2, unknown=True),
    "delay": Calibration(0.04, 0.05),
}
SIX = {**FOUR, "tilt": Calibration(0.3, 0.5, unknown=True), "high_pass": Calibration(0.2, 0.1)}


def only(*kinds: str) -> dict[str, Calibration]:
    return {kind: SIX[kind] for kind in kinds}


# Structure, gauge: every quantity, sums of DOFs, and the forces of connections with every law.
KINDS = {
    "motion, all four": (braced, ("acceleration", {1: 1.0}, FOUR, -1)),
    "velocity": (braced, ("velocity", {2: 1.0}, only("delay"), -1)),
    "drift": (braced, ("displacement", {2: 1.0, 1: -1.0}, only("gain", "offset"), -1)),
    "drift, delayed": (braced, ("displacement", {0: 1.0, 2: -1.0}, FOUR, -1)),
    "strain": (braced, ("displacement", {0: 0.4, 1: -0.2, 2: 0.1}, only("gain"), -1)),
    "force": (braced, ("force", {0: 1.0}, only("gain", "delay"), -1)),
    "ground": (braced, ("ground_acceleration", {}, FOUR, -1)),
    "Duffing": (braced, ("connection_force", {}, FOUR, 1)),
    "linear brace": (braced, ("connection_force", {}, only("gain"), 4)),
    "Van der Pol": (braced, ("connection_force", {}, only("gain", "delay"), 5)),
    "Bouc-Wen": (hysteretic, ("connection_force", {}, FOUR, 1)),
    "Bouc-Wen to ground": (hysteretic, ("connection_force", {}, only("gain"), 2)),
    "known": (braced, ("acceleration", {0: 1.0}, {}, -1)),
    "tilting": (braced, ("acceleration", {1: 1.0}, SIX, -1)),
    "behind a filter": (braced, ("acceleration", {1: 1.0}, SIX, -1, True, 1)),
    "behind a filter of second order": (braced, ("acceleration", {0: 1.0}, SIX, -1, True, 2)),
    "ground behind a filter": (braced, ("ground_acceleration", {}, only("gain", "high_pass"), -1, True, 2)),
}


def posed(kind: str) -> tuple[NormalEquations, NoiseModel]:
    """Histories without physics; one accelerometer beside the gauge, and one force on the first DOF."""
    build, (quantity, weights, calibration, *more) = KINDS[kind]
    structure = build()
    rng, n = np.random.default_rng(7), structure.ndof
    gauge = Gauge("x", quantity, weights, OWN, rng.normal(size=len(OWN)), calibration, *more)
    columns = {name: np.full((len(TIME), n), np.nan) for name in ("displacement", "velocity", "acceleration")}
    columns["acceleration"][:, -1] = rng.normal(size=len(TIME))
    force = np.zeros((len(TIME), n))
    force[:, 0] = rng.normal(size=len(TIME))
    ground = gauge.history(TIME) if quantity == "ground_acceleration" else None
    if gauge.dof is not None and quantity in columns:
        columns[quantity][:, gauge.dof] = gauge.history(TIME)
    record = Record(
        TIME, **columns, force=force, unforced=np.arange(n) > 0, gauges=(gauge,), ground_acceleration=ground
    )
    uncertain = [
        Parameter(p, i, float(values[i]), 0.1 * float(values[i]) or 0.1, unknown=True)
        for p, values in structure.parameters.items()
        if p in ("k", "c", "kappa", "mu")
        for i in range(len(values))
    ]
    inputs = inputs_of(structure, record)
    problem = Problem(structure, record, (*uncertain, *sensor_parameters(record)), inputs=inputs)
    settings = InferenceSettings(12, 1e-6, learn_spread=True, pooled=False)
    evidence = settings.solved_by(problem, [built(Spline(intervals=5), problem)], "cpu", History(False))
    (equations,) = evidence.equations.each
    noise = replace(starting_noise(equations), taken_up=np.array([7.3]))
    noise.response[GAUGE][:] = 0.6
    return equations, noise


def somewhere(equations: NormalEquations, seed: int = 5, size: float = 0.3) -> Point:
    generator, start = torch.Generator().manual_seed(seed), equations.start()
    drawn = [torch.randn(len(x), generator=generator, dtype=x.dtype) for x in (start.unknowns, start.parameters)]
    return Point(*(size * x for x in drawn))


def after(point: Point, step: Point, length: float) -> Point:
    return Point(point.unknowns + length * step.unknowns, point.parameters + length * step.parameters)


def residual(equations: NormalEquations, point: Point) -> np.ndarray:
    return equations.gauge_residuals(point)[0].flatten().numpy()


def slope(equations: NormalEquations, point: Point, step: Point, length: float = 1e-5) -> np.ndarray:
    """Central difference of a gauge's residuals along a step."""
    ends = [residual(equations, after(point, step, sign * length)) for sign in (1.0, -1.0)]
    return (ends[0] - ends[1]) / (2.0 * length)


@pytest.mark.parametrize("kind", KINDS)
def test_normal_equations_are_products_of_the_jacobian(kind):
    """What the gauge adds to the Hessian is J' J / sigma^2, seen along a few directions."""
    equations, noise = posed(kind)
    point, steps = somewhere(equations), [somewhere(equations, seed) for seed in range(6, 11)]
    noise = replace(noise, taken_up=None)
    without = replace(noise, response={**noise.response, GAUGE: np.array([1e12])})
    with_it, alone = (dense(equations.assemble(point, levels)) for levels in (noise, without))
    every = np.stack([np.concatenate((s.unknowns.numpy(), s.parameters.numpy())) for s in steps])
    slopes = np.stack([slope(equations, point, s) for s in steps])
    expected = slopes @ slopes.T / 0.6**2
    assert np.linalg.matrix_rank(expected) == len(steps)
    np.testing.assert_allclose(every @ (with_it - alone) @ every.T, expected, atol=2e-6 * np.abs(expected).max())


@pytest.mark.parametrize("kind", KINDS)
def test_the_gradient_is_that_of_the_losses(kind):
    """Of every loss, the factor that a gain has among them."""
    equations, noise = posed(kind)
    point, step = somewhere(equations), somewhere(equations, seed=6)
    system = equations.assemble(point, noise)
    found = float(system.gradient @ step.unknowns.numpy() + system.corner_gradient @ step.parameters.numpy())
    length = 1e-5
    up, down = (sum(equations.losses(after(point, step, sign * length), noise).values()) for sign in (1.0, -1.0))
    assert found == pytest.approx(0.5 * (up - down) / (2.0 * length), rel=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_what_a_small_step_moves(kind):
    equations, _ = posed(kind)
    point, step = somewhere(equations), somewhere(equations, seed=6)
    moved = equations.moved_gauges(point, step)[0].flatten().numpy()
    np.testing.assert_allclose(moved, slope(equations, point, step), atol=1e-6 * np.abs(moved).max())


def test_the_gain_has_a_loss_of_its_own_where_it_is_unknown():
    equations, noise = posed("motion, all four")
    point = equations.start()
    assert equations.losses(point, noise)["gain"] == pytest.approx(2.0 * 7.3 * np.log(1.2))
    assert equations.losses(point, replace(noise, taken_up=None))["gain"] == 0.0
    known, levels = posed("drift, delayed")
    assert "gain" in known.losses(known.start(), levels)
    equations, noise = posed("known")
    assert equations.losses(equations.start(), noise)["gain"] == 0.0


def test_samples_that_may_have_felt_motion_outside_the_record_are_left_out():
    """Delay 0.04 s, known to 0.05 s: three standard deviations either way. The features begin at 1.7 s."""
    record = np.linspace(0.0, 9.7, 500)
    late, on_time = (posed(kind)[0] for kind in ("motion, all four", "known"))
    for equations, first, last in ((late, 1.7 + 0.19, 8.3 - 0.11), (on_time, 1.7, 8.3)):
        (rows,) = equations.gauge_rows
        rows.gauge = replace(rows.gauge, time=record, values=record)
        np.testing.assert_array_equal(rows._inside(1.7, 8.3), (record >= first) & (record <= last))


def test_a_delay_beyond_the_record_s_reach_is_refused_and_takes_no_memory():
    """All samples then stood in the last interval, and every interval's features were held for as many."""
    equations, noise = posed("motion, all four")
    point, (rows,) = equations.start(), equations.gauge_rows
    place = next(i for i, parameter in enumerate(equations.uncertain) if parameter.kind == "delay")
    held = equations.losses(point, noise) and rows.moment(0.04).segments.mask.shape
    for by, finite in ((2.9, True), (-2.9, True), (3.1, False), (200.0, False)):
        far = point.parameters.clone()
        far[place] = by
        assert math.isfinite(equations.losses(Point(point.unknowns, far), noise)[GAUGE]) is finite
        assert rows._moment is not None
        assert rows._moment.segments.mask.shape[1] <= held[1] + 2


def dense(system) -> np.ndarray:
    border = csr_matrix(system.border).toarray()
    return np.block([[system.band.dense(), border], [border.T, system.corner]])
