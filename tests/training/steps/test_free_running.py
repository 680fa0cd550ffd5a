"""Parameters with which a structure runs free, under a model that is only nearly right."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from scipy.signal import lsim
from solved_records import by_spline

from pinn_cli.record.channel import Channel, unknown_calibration
from pinn_cli.record.record import Record
from pinn_cli.record.spectrum import visible_floor
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.training.estimate import Estimate

M, C, K = 50.0, 120.0, 2e4
RATE, SAMPLES = 100.0, 2000


@cache
def dragged(drag: float, seed: int = 0) -> Record:
    """A mass, its spring and damper, and a drag that goes with the square of the velocity; force, position, 60 dB."""
    rng = np.random.default_rng(seed)
    time = np.arange(SAMPLES) / RATE
    tones, phase = 2.0 * np.pi * np.arange(0.5, 8.0, 0.1), rng.uniform(0.0, 2.0 * np.pi, 75)

    def force(t: float) -> float:
        return min(t, 1.0) * 60.0 * np.sqrt(2.0 / 75) * float(np.cos(tones * t + phase).sum())

    def rate(t: float, y: np.ndarray) -> list[float]:
        u, v = y
        return [v, (force(t) - C * v - K * u - drag * v * abs(v)) / M]

    u = solve_ivp(rate, (0.0, time[-1]), [0.0, 0.0], "DOP853", time, rtol=1e-9, atol=1e-13, max_step=0.01).y[0]
    acting = np.array([force(t) for t in time])
    noisy = u + 1e-3 * u.std() * rng.normal(size=SAMPLES)
    measured = acting + 1e-3 * acting.std() * rng.normal(size=SAMPLES)
    nothing = np.full((SAMPLES, 1), np.nan)
    return Record(time, noisy[:, None], nothing, nothing, measured[:, None], np.array([False]))


@cache
def identified(drag: float) -> Estimate:
    structure = build_chain(1, Linear(), m=40.0, c=60.0, k=1.5e4)
    problem = StateParameter(unobserved=[], unknown=["m_1", "c_1", "k_1"]).pose(structure, [dragged(drag)]).alone
    return by_spline(problem)


def output_error(record: Record) -> tuple[np.ndarray, float]:
    """M, c and k with which a simulation from rest comes nearest to the sensor, and its NMSE, %."""
    u, force = record.displacement[:, 0], record.force[:, 0]

    def missed(logarithms: np.ndarray) -> np.ndarray:
        m, c, k = np.exp(logarithms)
        system = ([[0.0, 1.0], [-k / m, -c / m]], [[0.0], [1.0 / m]], [[1.0, 0.0]], [[0.0]])
        return (lsim(system, force, record.time)[1] - u) / u.std()

    found = least_squares(missed, np.log([M, C, K]))
    return np.exp(found.x), 100.0 * float(np.mean(found.fun**2))


@pytest.mark.slow
def test_a_model_without_its_drag_gets_the_parameters_of_an_output_error_fit():
    estimate, (fitted, missed) = identified(300.0), output_error(dragged(300.0))
    story, *others = estimate.stories
    assert [story.name, *sorted(other.name for other in others)] == ["free run", "force", "smooth force"]
    found = np.array([p.estimate for p in estimate.parameters])
    assert found == pytest.approx(fitted, rel=1e-2)  # lsim joins samples of the force by lines
    assert all(story.free_run < 1.02 * missed < 1.1 * other.free_run for other in others)
    # White noise of the size of what is left would make them look several times as well known.
    std = np.array([p.std for p in estimate.parameters])
    assert (std > 2e-3 * fitted).all()
    assert (std < 0.1 * fitted).all()


def test_the_motion_is_that_of_the_more_probable_force():
    estimate = identified(300.0)
    left = estimate.response.displacement - dragged(300.0).displacement
    assert np.std(left) < 2e-3 * np.std(dragged(300.0).displacement)
    (smooth,) = (story for story in estimate.stories if story.name == "smooth force")
    assert [p.estimate for p in estimate.of_motion or ()] == [p.estimate for p in smooth.parameters]
    assert smooth.force_std > 0.0
    assert smooth.correlation_time > 0.0


def test_a_model_that_holds_has_one_story():
    estimate = identified(0.0)
    assert estimate.stories == ()
    assert [p.estimate for p in estimate.parameters] == pytest.approx([M, C, K], rel=2e-3)


def test_a_load_cell_of_an_unknown_delay_makes_no_second_story():
    """The least discrepancy was a part of the discrepancy itself, and no solution was as good as without any."""
    record, structure = dragged(0.0), build_chain(1, Linear(), m=M, c=60.0, k=1.5e4)
    unknown = unknown_calibration("delay", record.time, record.force[:, 0])
    cell = Channel("f", "force", {0: 1.0}, record.time, record.force[:, 0], {"delay": unknown})
    late = replace(record, calibrated=(cell,))
    estimate = by_spline(StateParameter(unobserved=[], unknown=["c_1", "k_1"]).pose(structure, [late]).alone)
    assert estimate.stories == ()
    (delay,) = (p for p in estimate.parameters if p.kind == "delay")
    assert abs(delay.estimate) < 4.0 * delay.std


def test_a_load_cell_is_no_noisier_than_its_spectrum_shows():
    shown = visible_floor(dragged(300.0).force[:, 0], 1.0 / RATE)
    assert shown is not None
    assert identified(300.0).noise.sensors["force"][0] < 1.6 * shown
