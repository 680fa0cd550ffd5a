"""The search for the process noise: what was put in is found, a coloured one is widened."""

import numpy as np
import pytest
from small_problems import QUANTITIES, excitation, relative_error, small_chain

from pinn_cli.baseline.iterated_smoother import IteratedSmoother, begun, most_probable, widened
from pinn_cli.baseline.state_space import NoiseLevels, StateSpace
from pinn_cli.record.excitation import BandedNoise
from pinn_cli.record.record import Record
from pinn_cli.record.response import Response
from pinn_cli.record.simulation import Simulation
from pinn_cli.scheme.problem import Problem

DURATION, SAMPLES, FINE = 24.0, 513, 0.001


def disturbed(unknown: np.ndarray, nonlinearity: str = "duffing") -> tuple[IteratedSmoother, NoiseLevels, Response]:
    """A chain under a known held force and an unknown one (N, n), all accelerations seen with little noise."""
    structure, simulation = small_chain(nonlinearity), Simulation(DURATION, SAMPLES, "zero_order")
    known, time = excitation(structure, DURATION, SAMPLES).force(simulation.time), simulation.time
    truth = simulation.run(structure, lambda t: (known + unknown)[np.searchsorted(time, t)])
    rng = np.random.default_rng(2)
    noisy = [getattr(truth, q) + FINE * rng.normal(size=known.shape) for q in QUANTITIES]
    record = Record(time, *noisy, known, np.arange(3) > 0, "zero_order_hold").keep({"acceleration": (1, 2, 3)})
    space = StateSpace(Problem(structure, record))
    return IteratedSmoother(space, passes=12, learn_spread=True), space.first_levels(), truth


def white(level: float, seed: int = 1) -> np.ndarray:
    return level * np.random.default_rng(seed).normal(size=(SAMPLES, 3))


@pytest.mark.parametrize(("level", "nonlinearity"), [(0.02, "linear"), (0.2, "duffing")])
def test_the_process_noise_that_was_put_in_is_found(level: float, nonlinearity: str) -> None:
    smoother, levels, truth = disturbed(white(level), nonlinearity)
    best = most_probable(smoother, levels)
    assert best.levels.discrepancy == pytest.approx(level, rel=0.1)
    assert relative_error(best.trajectory.states[:, :3], truth.displacement) < 0.1


def test_a_right_model_needs_no_process_noise() -> None:
    smoother, levels, _ = disturbed(np.zeros((SAMPLES, 3)))
    best = most_probable(smoother, levels)
    as_sensor_noise = FINE * 10.0  # N, on a mass of 10 kg
    assert best.levels.discrepancy < 0.2 * as_sensor_noise


def test_a_coloured_model_error_is_widened_and_a_white_one_is_not() -> None:
    band = BandedNoise(3, DURATION, SAMPLES, [0.1, 1.0], 0.1, [1, 2, 3], seed=4)
    coloured = band.force(np.linspace(0.0, DURATION, SAMPLES))
    ratios = []
    for unknown in (coloured, white(0.1)):
        smoother, levels, _ = disturbed(unknown)
        best = most_probable(smoother, levels)
        ratios.append(widened(smoother, best).levels.discrepancy / best.levels.discrepancy)
    # 0.9 Hz of 10.7 Hz: a twelfth of the values.
    assert ratios[0] == pytest.approx(12.0**0.5, rel=0.3)
    assert ratios[1] < 1.25


def test_passes_settle_quadratically() -> None:
    smoother, levels, _ = disturbed(white(0.05))
    settled = smoother.settle(begun(smoother, levels).trajectory, levels, 1e-9)
    assert settled.step < 1e-9
    assert len(smoother.history) < 10
