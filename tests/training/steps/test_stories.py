"""Models that are only nearly right: parameters with which they run free, and a smooth force that they leave out."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from one_record import by_spline
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from scipy.signal import lsim
from structures import modal

from benchmarks.nearly_right.machines import measured
from pinn_cli.record.channel import Channel, unknown_calibration
from pinn_cli.record.record import Record
from pinn_cli.record.spectrum import visible_floor
from pinn_cli.scheme.problem import Problem, with_every_force
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.training import inference
from pinn_cli.training.estimate import Estimate, ParameterEstimate
from pinn_cli.training.noise_model import NoiseLevels, NoiseModel
from pinn_cli.training.reported import stories
from pinn_cli.training.steps import smooth_force
from pinn_cli.training.steps.free_running import _is_misled
from pinn_cli.training.steps.smooth_force import fit_smooth_force

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


@pytest.mark.parametrize(("least", "misled"), [(0.0, False), (0.5, True)])
def test_a_discrepancy_that_was_widened_is_compared_as_it_was(least: float, misled: bool):
    """What none of the record shows has any colour: widened for it, the record was "far more probable without"."""

    def trained(noise: NoiseLevels, point: object = None) -> SimpleNamespace:
        (level,) = noise.records
        too_much, too_little = level.discrepancy - 1.0, least - level.discrepancy
        log_evidence = -100.0 * (max(too_much, 0.0) + max(too_little, 0.0))
        return SimpleNamespace(noise=noise, log_evidence=log_evidence, solution=SimpleNamespace(point=None))

    white = NoiseModel({}, np.zeros(1), 1.0, np.nan)
    levels = NoiseLevels((white.widened(1 / 16),), 1.0)
    assert trained(levels).log_evidence < trained(NoiseLevels((white,), 1.0)).log_evidence - 20.0
    assert _is_misled(SimpleNamespace(train=trained), trained(levels), [replace(white, discrepancy=1e-6)]) == misled


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


MASSES, DAMPERS, SPRINGS = np.array([50.0, 40.0]), np.array([90.0, 60.0]), np.array([4e4, 3e4])
STOREY_RATE, STOREY_SAMPLES = 100.0, 1500


@cache
def storeys(drag: float = 600.0, pushing: float = 0.0) -> Record:
    """Two storeys under a force on DOF 2, its cell and both accelerometers, 50 dB.

    Args:
        drag: Between the fixed end and DOF 1, N s^2/m^2: the model has none.
        pushing: Root mean square of a force on DOF 1 that nobody measures, N.
    """
    rng, time = np.random.default_rng(3), np.arange(STOREY_SAMPLES) / STOREY_RATE
    tones, phase = 2.0 * np.pi * np.arange(1.0, 9.0, 0.1), rng.uniform(0.0, 2.0 * np.pi, 80)
    other = np.random.default_rng(4).uniform(0.0, 2.0 * np.pi, 80)

    def force(t: float, of: np.ndarray = phase, level: float = 80.0) -> float:
        return min(t, 1.0) * level * np.sqrt(2.0 / 80) * float(np.cos(tones * t + of).sum())

    def accelerations(t: float, y: np.ndarray) -> np.ndarray:
        e, de = np.diff(y[:2], prepend=0.0), np.diff(y[2:], prepend=0.0)
        r = DAMPERS * de + SPRINGS * e
        r[0] += drag * de[0] * abs(de[0]) - force(t, other, pushing)
        return np.array([r[1] - r[0], force(t) - r[1]]) / MASSES

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate((y[2:], accelerations(t, y)))

    states = solve_ivp(rate, (0.0, time[-1]), np.zeros(4), "DOP853", time, rtol=1e-9, atol=1e-12, max_step=0.01).y
    true = np.array([accelerations(t, y) for t, y in zip(time, states.T, strict=True)])
    acting = np.zeros((STOREY_SAMPLES, 2))
    acting[:, 1] = [force(t) for t in time]
    noisy, cell = (x + 3e-3 * x.std(axis=0) * rng.standard_normal(x.shape) for x in (true, acting))
    nothing = np.full((STOREY_SAMPLES, 2), np.nan)
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
    smooth, white = (said(found(storeys()), story) for story in ("smooth force", "force"))
    for name, true in (("c_2", DAMPERS[1]), ("k_1", SPRINGS[0]), ("k_2", SPRINGS[1])):
        assert smooth[name].std < 0.1 * white[name].std
        assert abs(smooth[name].estimate - true) < 3.0 * smooth[name].std


@pytest.mark.slow
def test_the_force_has_the_place_of_what_the_model_lacks():
    """A drag between the fixed end and DOF 1 is a force there; what is elsewhere is as well known as in a right one."""
    estimate = found(storeys())
    (place,) = (one.place for one in estimate.stories if one.name == "smooth force")
    assert place == "DOF 1"
    assert said(estimate, "smooth force")["c_2"].std < 0.01 * DAMPERS[1]
    named = {doubt.kind: doubt for doubt in estimate.doubts}
    assert named["quadratic damping"].share > 0.5  # so its place alone says nothing more
    assert "force" not in named


@pytest.mark.slow
def test_a_force_of_any_history_on_one_dof_is_told_with_its_place():
    """White from 0.5 to 8 Hz on DOF 1, which nobody measured, beside the measured one on the roof."""
    estimate = found(storeys(drag=0.0, pushing=8.0))
    (named,) = estimate.doubts
    assert (named.kind, named.of) == ("force", "DOF 1")
    values = said(estimate, "smooth force")
    for name, true in (("c_2", DAMPERS[1]), ("k_2", SPRINGS[1])):
        assert abs(values[name].estimate - true) < max(3.0 * values[name].std, 0.01 * true)


@pytest.mark.slow
def test_what_runs_free_allows_for_what_a_smooth_force_says(monkeypatch):
    others = tuple(one for one in inference.STEPS if one[0] is not fit_smooth_force)
    with monkeypatch.context() as patched:
        patched.setattr(inference, "STEPS", others)
        alone = next(p for p in found.__wrapped__(storeys()).parameters if p.name == "c_2")
    beside = next(p for p in found(storeys()).parameters if p.name == "c_2")
    assert beside.estimate == pytest.approx(alone.estimate, rel=1e-3)
    assert not alone.lower_90 < DAMPERS[1] < alone.upper_90
    assert beside.lower_90 < DAMPERS[1] < beside.upper_90


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
    chain = Problem(build_chain(2, Linear(), m=50.0, c=60.0, k=3e4), storeys())
    assert with_every_force(chain).inputs.forces == (0, 1)


def test_modes_get_forces_on_dofs_that_tell_them_apart():
    structure = modal()
    shown = np.zeros((50, 4))
    record = Record(np.arange(50) / 50.0, shown, shown, shown, shown, np.ones(4, dtype=bool))
    forces = list(with_every_force(Problem(structure, record)).inputs.forces)
    assert len(forces) == 3
    assert np.linalg.cond(structure.shapes.matrix[forces]) < 5.0


@pytest.mark.parametrize(("level", "told"), [(0.05, []), (5.0, ["force"])])
def test_a_force_that_is_nothing_beside_those_of_the_connections_has_no_place(monkeypatch, level: float, told: list):
    spring = SimpleNamespace(name="k_1", estimate=1.0, std=0.1, unknown=True)
    smooth = SimpleNamespace(by_record=[(None, None)], log_odds_of_place=40.0)
    monkeypatch.setattr(stories, "place_of", lambda smooth: "DOF 1")
    monkeypatch.setattr(stories, "rms_force", lambda equations, point: 1e3)
    found = SimpleNamespace(summary={"std_unknown_force": level}, parameters=[spring])
    doubts = stories._of_place(smooth, found, SimpleNamespace(parameters=[spring]))
    assert [doubt.kind for doubt in doubts] == told


def test_a_spectrum_with_which_the_record_is_less_probable_is_not_taken(monkeypatch):
    """That of a force that is next to nothing is one of rounding: it was followed for two minutes."""
    probable, after = {"white": 5.0, "coloured": 9.0, "absurd": -4e5}, {"white": "coloured", "coloured": "absurd"}
    monkeypatch.setattr(smooth_force, "fit_force_spectrum", after.get)
    monkeypatch.setattr(smooth_force, "_log_evidence", probable.get)
    monkeypatch.setattr(smooth_force, "set_force_level", lambda story: None)
    assert smooth_force._of_own_spectrum("white") == "coloured"
