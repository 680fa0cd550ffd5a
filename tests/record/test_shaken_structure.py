"""Structures on moving ground against equations of motion that are written out here, and what of it is measured."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pinn_cli.record.excitation.ground_motion import GroundMotion
from pinn_cli.record.free_run import free_run
from pinn_cli.record.response import QUANTITIES
from pinn_cli.record.simulated import Noise, Simulated
from pinn_cli.record.simulation import Simulation, simulate
from pinn_cli.settings.errors import InputError
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing, Linear

M, C, K, KAPPA = (2000.0, 2000.0, 1500.0), (5e3, 4e3, 3e3), (8e6, 7.2e6, 5.6e6), 1e10
FRAME = build_chain(3, Duffing(), m=list(M), c=list(C), k=list(K), kappa=KAPPA)
# The same masses on soft linear springs, which take few steps, for what is about sensors alone.
SOFT = build_chain(3, Linear(), m=list(M), c=list(C), k=[2e5, 1.8e5, 1.4e5])
DURATION, SAMPLES = 6.0, 601
FORCE = {"band": [0.5, 10.0], "rms": 2e3, "dofs": [2], "seed": 1}
GENERATED = {"rise": 1.0, "strong": 3.0, "decay": 1.0, "highest": 15.0}


def by_hand(motion: GroundMotion, time: np.ndarray) -> tuple[np.ndarray, ...]:
    """Displacement, velocity (relative) and absolute acceleration of the three storeys, (N, 3) each."""

    def absolute(t, x1, x2, x3, v1, v2, v3):
        r1 = C[0] * v1 + K[0] * x1 + KAPPA * x1**3
        r2 = C[1] * (v2 - v1) + K[1] * (x2 - x1) + KAPPA * (x2 - x1) ** 3
        r3 = C[2] * (v3 - v2) + K[2] * (x3 - x2) + KAPPA * (x3 - x2) ** 3
        f = motion.force(np.array([t]))[0, 1]
        return (r2 - r1) / M[0], (f + r3 - r2) / M[1], -r3 / M[2]

    def rate(t, y):
        ground = motion.ground(np.array([t]))[0]
        return [*y[3:], *(a - ground for a in absolute(t, *y))]

    options = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-14, "max_step": 0.01}
    y = solve_ivp(rate, (0.0, time[-1]), np.zeros(6), t_eval=time, **options).y
    return y[:3].T, y[3:].T, np.array([absolute(t, *state) for t, state in zip(time, y.T, strict=True)])


@pytest.mark.parametrize("settings", [{"path": "el_centro", "force": FORCE}, GENERATED], ids=["el_centro", "filtered"])
def test_it_moves_as_the_equations_written_out_say(request, settings):
    if "path" in settings:
        folder = request.getfixturevalue("shared") / "data" / "ground_motion"
        settings = {**settings, "path": str(folder / f"{settings['path']}.csv")}
    duration, samples = 1.5, 151
    motion = GroundMotion(3, duration, samples, **settings)
    simulation = Simulation(duration, samples)
    found = simulation.run(FRAME, motion.force, motion.ground)
    u, v, absolute = by_hand(motion, simulation.time)
    for given, expected in ((found.displacement, u), (found.velocity, v), (found.acceleration, absolute)):
        assert np.sqrt(np.mean((given - expected) ** 2)) < 1e-6 * np.sqrt(np.mean(expected**2))
    relative = simulation.run(FRAME, motion.force, motion.ground, "relative").acceleration
    np.testing.assert_allclose(relative, found.acceleration - found.ground_acceleration[:, None], atol=1e-12)
    np.testing.assert_array_equal(found.ground_acceleration, motion.ground(simulation.time))
    np.testing.assert_array_equal(found.force, motion.force(simulation.time))


def simulated(frame: str = "absolute", **noise) -> Simulated:
    motion = GroundMotion(3, DURATION, SAMPLES, force=FORCE, **GENERATED)
    return Simulated(motion, Simulation(DURATION, SAMPLES), Noise(**noise), frame)


def test_a_simulated_record_measures_the_ground_with_noise_of_its_own():
    record, truth = (it := simulated(snr_db=30.0, seed=4).measure(SOFT)).record, it.truth.response
    noise = record.ground_acceleration - truth.ground_acceleration
    ratio = 10.0 * math.log10(np.mean(truth.ground_acceleration**2) / np.mean(noise**2))
    assert ratio == pytest.approx(30.0, abs=0.5)
    assert record.unforced.tolist() == [True, False, True]
    others = [getattr(record, q) - getattr(truth, q) for q in QUANTITIES]
    columns = [x for each in others for x in each.T if x.any()]
    assert max(abs(np.corrcoef(noise, x)[0, 1]) for x in columns) < 0.15


def test_repeats_and_seeds_know_the_ground():
    clean = simulated(snr_db=None).measure(SOFT).truth.response
    true, (_, scatter) = clean.ground_acceleration, Noise(20.0, repeats=4).measured(clean)
    expected = np.std(Noise(20.0).added_to(clean).ground_acceleration - true) / 2.0
    assert scatter.noise_of_mean("ground_acceleration")[0] == pytest.approx(expected, rel=0.1)
    seeds = dict(zip(QUANTITIES, (1, 2, 3, 4), strict=True))
    with pytest.raises(InputError, match="seed for ground_acceleration"):
        Noise(20.0, seeds=seeds).added_to(clean)
    drawn = Noise(20.0, seeds={**seeds, "ground_acceleration": 5}).added_to(clean)
    expected = np.random.RandomState(5).standard_normal(SAMPLES)
    assert np.corrcoef(drawn.ground_acceleration - true, expected)[0, 1] > 0.999


@pytest.mark.parametrize(("frame", "first"), [("absolute", 0), ("relative", 200)])
def test_a_free_run_goes_on_under_the_measured_ground(frame, first):
    it = simulated(frame, snr_db=None).measure(SOFT)
    record, truth = it.record, it.truth.response
    assert record.frame == frame
    found = free_run(SOFT, record, (truth.displacement[first], truth.velocity[first]), first=first)
    for quantity in ("displacement", "acceleration"):
        expected = getattr(truth, quantity)[first:]
        assert np.max(np.abs(getattr(found, quantity) - expected)) < 1e-4 * np.max(np.abs(expected))
    np.testing.assert_allclose(found.ground_acceleration, record.ground_acceleration[first:], atol=1e-9)
    still = free_run(SOFT, replace(record, force=0.0 * record.force, ground_acceleration=0.0 * record.time))
    assert not still.displacement.any()


def test_a_held_force_and_a_relative_frame_without_ground_are_refused():
    motion = GroundMotion(3, DURATION, SAMPLES)
    held = Simulated(motion, Simulation(DURATION, SAMPLES, hold="zero_order"), Noise())
    with pytest.raises(InputError, match=r"simulation\.hold=zero_order: must be exact where the ground moves"):
        held.measure(FRAME)


def test_a_coordinate_may_move_with_the_ground_in_part():
    """A cart on the ground and a lever that half of the ground's motion reaches, written out."""
    chain = build_chain(2, Linear(), m=[2.0, 3.0], c=[0.5, 0.4], k=[80.0, 60.0])
    structure = replace(chain, influence=np.array([1.0, 0.5]))
    time = np.linspace(0.0, 2.0, 201)

    def ground(t):
        return np.sin(4.0 * t) * np.exp(-0.3 * t)

    def rate(t, y):
        x1, x2, v1, v2 = y
        r1, r2 = 0.5 * v1 + 80.0 * x1, 0.4 * (v2 - v1) + 60.0 * (x2 - x1)
        return [v1, v2, (r2 - r1) / 2.0 - ground(t), -r2 / 3.0 - 0.5 * ground(t)]

    y = solve_ivp(rate, (0.0, 2.0), np.zeros(4), t_eval=time, method="DOP853", rtol=1e-11, atol=1e-13).y

    def still(t):
        return np.zeros((len(t), 2))

    found = simulate(structure, still, time, substeps=4, ground=ground)
    np.testing.assert_allclose(found.displacement, y[:2].T, atol=1e-8)
    relative = simulate(structure, still, time, substeps=4, ground=ground, frame="relative").acceleration
    np.testing.assert_allclose(found.acceleration - relative, ground(time)[:, None] * [1.0, 0.5], atol=1e-12)
