"""The story in which what a model leaves out is a smooth force."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from solved_records import by_spline
from structures import modal

from benchmarks.nearly_right.machines import measured
from pinn_cli.record.record import Record
from pinn_cli.scheme.problem import Problem, with_every_force
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.training import inference
from pinn_cli.training.estimate import Estimate, ParameterEstimate
from pinn_cli.training.steps.smooth_force import fit_smooth_force

M, C, K = np.array([50.0, 40.0]), np.array([90.0, 60.0]), np.array([4e4, 3e4])
RATE, SAMPLES = 100.0, 1500
DRAG = 600.0  # N s^2/m^2, between the fixed end and DOF 1: the model has none


def dragged() -> Record:
    """Two storeys with a drag, a force on DOF 2, its cell and both accelerometers, 50 dB."""
    return lacking(DRAG, 0.0)


def pushed() -> Record:
    """The same without a drag, under another force, on DOF 1."""
    return lacking(0.0, 8.0)


@cache
def lacking(drag: float, pushing: float) -> Record:
    """Two storeys under a force on DOF 2, its cell and both accelerometers, 50 dB.

    Args:
        drag: Between the fixed end and DOF 1, N s^2/m^2.
        pushing: Root mean square of a force on DOF 1 that nobody measures, N.
    """
    rng, time = np.random.default_rng(3), np.arange(SAMPLES) / RATE
    tones, phase = 2.0 * np.pi * np.arange(1.0, 9.0, 0.1), rng.uniform(0.0, 2.0 * np.pi, 80)
    other = np.random.default_rng(4).uniform(0.0, 2.0 * np.pi, 80)

    def force(t: float, of: np.ndarray = phase, level: float = 80.0) -> float:
        return min(t, 1.0) * level * np.sqrt(2.0 / 80) * float(np.cos(tones * t + of).sum())

    def accelerations(t: float, y: np.ndarray) -> np.ndarray:
        e, de = np.diff(y[:2], prepend=0.0), np.diff(y[2:], prepend=0.0)
        r = C * de + K * e
        r[0] += drag * de[0] * abs(de[0]) - force(t, other, pushing)
        return np.array([r[1] - r[0], force(t) - r[1]]) / M

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate((y[2:], accelerations(t, y)))

    states = solve_ivp(rate, (0.0, time[-1]), np.zeros(4), "DOP853", time, rtol=1e-9, atol=1e-12, max_step=0.01).y
    true = np.array([accelerations(t, y) for t, y in zip(time, states.T, strict=True)])
    acting = np.zeros((SAMPLES, 2))
    acting[:, 1] = [force(t) for t in time]
    noisy, cell = (x + 3e-3 * x.std(axis=0) * rng.standard_normal(x.shape) for x in (true, acting))
    nothing = np.full((SAMPLES, 2), np.nan)
    return Record(time, nothing, nothing, noisy, cell, np.array([True, False]))


@cache
def found(record: Record) -> Estimate:
    structure = build_chain(2, Linear(), m=[50.0, 40.0], c=[60.0, 60.0], k=[3e4, 3e4])
    return by_spline(StateParameter(unobserved=[], unknown=["c_*", "k_*"]).pose(structure, [record]).alone)


def said(estimate: Estimate, story: str) -> dict[str, ParameterEstimate]:
    (parameters,) = (one.parameters for one in estimate.stories if one.name == story)
    return {p.name: p for p in parameters}


@pytest.mark.slow
def test_a_smooth_force_leaves_far_more_of_the_parameters_than_a_white_one():
    smooth, white = (said(found(dragged()), story) for story in ("smooth force", "force"))
    for name, true in (("c_2", C[1]), ("k_1", K[0]), ("k_2", K[1])):
        assert smooth[name].std < 0.1 * white[name].std
        assert abs(smooth[name].estimate - true) < 3.0 * smooth[name].std


@pytest.mark.slow
def test_the_force_has_the_place_of_what_the_model_lacks():
    """A drag between the fixed end and DOF 1 is a force there; what is elsewhere is as well known as in a right one."""
    estimate = found(dragged())
    (place,) = (one.place for one in estimate.stories if one.name == "smooth force")
    assert place == "DOF 1"
    assert said(estimate, "smooth force")["c_2"].std < 0.01 * C[1]
    named = {doubt.kind: doubt for doubt in estimate.doubts}
    assert named["quadratic damping"].share > 0.5  # so its place alone says nothing more
    assert "force" not in named


def test_a_force_of_any_history_on_one_dof_is_told_with_its_place():
    """White from 0.5 to 8 Hz on DOF 1, which nobody measured, beside the measured one on the roof."""
    estimate = found(pushed())
    (named,) = estimate.doubts
    assert (named.kind, named.of) == ("force", "DOF 1")
    values = said(estimate, "smooth force")
    for name, true in (("c_2", C[1]), ("k_2", K[1])):
        assert abs(values[name].estimate - true) < max(3.0 * values[name].std, 0.01 * true)


@pytest.mark.slow
def test_what_runs_free_allows_for_what_a_smooth_force_says(monkeypatch):
    others = tuple(one for one in inference.STEPS if one[0] is not fit_smooth_force)
    with monkeypatch.context() as patched:
        patched.setattr(inference, "STEPS", others)
        alone = next(p for p in found.__wrapped__(dragged()).parameters if p.name == "c_2")
    beside = next(p for p in found(dragged()).parameters if p.name == "c_2")
    assert beside.estimate == pytest.approx(alone.estimate, rel=1e-3)
    assert not alone.lower_90 < C[1] < alone.upper_90
    assert beside.lower_90 < C[1] < beside.upper_90


@pytest.mark.slow
def test_a_motion_from_which_nothing_is_predicted_is_none():
    """Accelerometers feel a floor that moves below the structure's band, which slow forces twice the size explain."""
    made = measured("floor", 2)
    time, guess = made.time[: made.half], made.guess.reshape(3, -1)
    shown, force = made.sensors[: made.half], np.zeros((made.half, 3))
    force[:, -1] = made.force[: made.half]
    nothing = np.full_like(shown, np.nan)
    record = Record(time, nothing, nothing, shown, force, np.array([True, True, False]))
    structure = build_chain(3, Linear(), m=guess[0], c=guess[1], k=guess[2])
    scheme = StateParameter(unobserved=[], unknown=["m_*", "c_*", "k_*"])
    estimate = by_spline(scheme.pose(structure, [record]).alone)
    assert estimate.stories[0].free_run < 2.0
    assert [p.estimate for p in estimate.of_motion or ()] == [p.estimate for p in said(estimate, "force").values()]


def test_every_coordinate_gets_a_force_of_its_own():
    chain = Problem(build_chain(2, Linear(), m=50.0, c=60.0, k=3e4), dragged())
    assert with_every_force(chain).inputs.forces == (0, 1)


def test_modes_get_forces_on_dofs_that_tell_them_apart():
    structure = modal()
    shown = np.zeros((50, 4))
    record = Record(np.arange(50) / 50.0, shown, shown, shown, shown, np.ones(4, dtype=bool))
    forces = list(with_every_force(Problem(structure, record)).inputs.forces)
    assert len(forces) == 3
    assert np.linalg.cond(structure.shapes.matrix[forces]) < 5.0
