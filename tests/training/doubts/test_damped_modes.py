"""Damping of a mode that no damper explains is told where the structure has it, and only there."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from lacking_records import RATE, K, M, moved, posed
from lacking_records import recorded as with_noise
from scipy.interpolate import make_interp_spline
from scipy.linalg import eigh
from scipy.signal import lsim
from small_problems import accelerations, measured, small_chain
from solved_records import by_spline

from pinn_cli.record.record import Record
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.building import damped
from pinn_cli.system.modes import NaturalModes
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import Estimate

RATIO = 0.06


def recorded(structure: Structure, seed: int = 0) -> Record:
    return accelerations(measured(structure, snr_db=40.0, duration=40.0, samples=801, seed=seed).record, (1, 2, 3))


def solved(records: list[Record], model: Structure) -> Estimate:
    """With unknown springs and dampers."""
    free = [p for p in model.every_parameter() if p.kind in ("k", "c")]
    wide = [replace(p, prior_std=10.0 * max(abs(p.prescribed), 1e-3), unknown=True) for p in free]
    return by_spline(JointProblem.of(*(Problem(model, record, tuple(wide)) for record in records)))


def of_modes() -> Structure:
    return damped(small_chain("linear").with_parameters(c=torch.zeros(3, dtype=torch.float64)), {"ratio": [RATIO] * 3})


@pytest.mark.parametrize("count", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_what_dampers_do_not_explain_of_a_mode_is_told(count):
    estimate = solved([recorded(of_modes(), seed) for seed in range(count)], small_chain("linear"))
    modes = NaturalModes.of(small_chain("linear").with_values({p.parameter: p.estimate for p in estimate.parameters}))
    first = estimate.doubts[0]
    assert first.kind == "damping ratio"
    mode = int(first.of.removeprefix("mode ")) - 1
    assert first.value + modes.damping_ratios[mode] == pytest.approx(RATIO, rel=0.2)


@pytest.mark.parametrize("count", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_dampers_that_are_right_leave_no_mode_in_doubt(count):
    assert solved([recorded(small_chain("linear"), seed) for seed in range(count)], small_chain("linear")).doubts == ()


def test_a_ratio_that_is_held_is_told():
    right = of_modes()
    held = right.with_parameters(zeta=torch.tensor([RATIO, 0.5 * RATIO, RATIO], dtype=torch.float64))
    springs = [replace(p, prior_std=abs(p.prescribed), unknown=True) for p in held.every_parameter() if p.kind == "k"]
    first = by_spline(Problem(held, recorded(right), tuple(springs))).doubts[0]
    assert (first.kind, first.of) == ("damping ratio", "mode 2")
    assert first.value == pytest.approx(0.5 * RATIO, rel=0.2)


def on_moving_ground(ratio: float) -> Record:
    """Accelerometers on all floors of a chain whose three modes have one damping ratio, and one on its ground."""
    truth, steps = moved(True, 1, ()), 8
    assert truth.ground_acceleration is not None
    count = len(truth.time)
    fine = np.arange((count - 1) * steps + 1) / steps
    ground = make_interp_spline(np.arange(count), truth.ground_acceleration, 7)(fine)
    rows, floors = np.eye(3) - np.eye(3, k=-1), np.zeros((count, 3))
    for square, shape in zip(*(x.T for x in eigh(rows.T @ np.diag(K) @ rows, np.diag(M))), strict=True):
        law = np.array([-square, -2.0 * ratio * square**0.5])
        system = np.array([[0.0, 1.0], law]), np.array([[0.0], [-shape @ M]]), np.eye(2), np.zeros((2, 1))
        floors += np.outer(lsim(system, ground, fine / RATE)[2][::steps] @ law, shape)
    return with_noise(replace(truth, acceleration=floors))


def test_the_ground_does_not_take_up_what_dampers_lack():
    """Its accelerometer was found eight times as noisy as it is, and nothing was named."""
    record = on_moving_ground(0.01)
    estimate = by_spline(posed(record))
    noise = 0.01 * record.ground_acceleration.std()
    assert estimate.noise.sensors["ground_acceleration"][0] == pytest.approx(noise, rel=0.8)
    assert estimate.stories[0].name == "free run"
    assert estimate.stories[0].free_run < 3.0
    assert (estimate.doubts[0].kind, estimate.doubts[0].of) == ("damping ratio", "mode 1")


@pytest.mark.slow
def test_what_stood_in_for_two_modes_gives_way_to_them():
    doubts = by_spline(posed(on_moving_ground(0.03))).doubts
    assert [(doubt.kind, doubt.of) for doubt in doubts] == [("damping ratio", f"mode {i}") for i in (2, 1, 3)]
