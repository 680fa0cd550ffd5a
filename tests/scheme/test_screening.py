"""Linear structures that make of the measured force what the sensors saw, from guesses that are far off."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from ambient_records import ambient_record
from frame_records import measure
from independent_records import Structure, measured
from small_problems import small_chain
from storeys import C, K, M, response
from structures import braced

from pinn_cli.record.channel import Channel
from pinn_cli.record.record import Record
from pinn_cli.record.simulated import Noise
from pinn_cli.record.simulation import simulate
from pinn_cli.scheme.calibration import doubts_about
from pinn_cli.scheme.linear_fit import JointFit, LinearFit, LinearStructure, spectra_under, what_acts
from pinn_cli.scheme.screening import HOPELESS, Candidate, Screening
from pinn_cli.system.building import chain_of
from pinn_cli.system.connection import Linear

# Row i: which displacements stretch connection i of a chain of three.
STRETCH = np.eye(3) - np.eye(3, k=-1)
CHAIN = small_chain("linear")
TRUE = {"m": M, "c": C, "k": K, "loss": np.zeros(1)}


@cache
def storeys(
    quantity: str = "acceleration", dofs: tuple[int, ...] = (1, 2, 3), snr_db: float = 30.0, duration: float = 20.0
) -> Record:
    truth = response(1, duration=duration)
    return measured(Structure(M, C, K, np.zeros(3)), truth, {quantity: dofs}, snr_db).record


def known(*unknown: str) -> dict[str, np.ndarray]:
    return {kind: np.where(kind in unknown, np.nan, values) for kind, values in TRUE.items()}


def guess(**factors: float) -> dict[str, np.ndarray]:
    return {kind: factors.get(kind, 1.0) * np.array([1.0, 1.15, 0.9]) * TRUE[kind] for kind in ("m", "k")}


@pytest.mark.parametrize(
    ("unknown", "factors", "sensors"),
    [
        ("k", {"k": 0.1}, ("acceleration", (1, 2, 3))),
        ("k", {"k": 10.0}, ("acceleration", (1, 2, 3))),
        ("k", {"k": 10.0}, ("velocity", (1,))),
        ("m", {"m": 0.2}, ("acceleration", (1, 2, 3))),
        ("m", {"m": 3.0}, ("acceleration", (1, 2, 3))),
        ("mck", {"k": 10.0, "m": 2.0}, ("acceleration", (1, 2, 3))),  # the force says how heavy all is
    ],
    ids=str,
)
def test_what_is_unknown_comes_out_from_a_guess_a_decade_off(unknown, factors, sensors):
    found = list(Screening(CHAIN, [storeys(*sensors)], known(*unknown), guess(**factors)).candidates())
    assert found[0].misfit < 0.1
    for kind, values in TRUE.items():
        tolerance = 0.0 if kind not in unknown else 0.6 if kind == "c" else 0.05
        np.testing.assert_allclose(found[0].parameters[kind], values, rtol=tolerance)
    misfits = [candidate.misfit for candidate in found]
    assert misfits == sorted(misfits)
    for i, one in enumerate(found):
        for kind in set(unknown) - {"c"}:
            apart = [np.abs(np.log(one.parameters[kind] / other.parameters[kind])).max() for other in found[:i]]
            assert unknown != kind or min(apart, default=1.0) > 0.02


def test_the_best_lies_at_the_bottom_of_its_valley():
    """Noise makes valleys long and flat: a start half-way down one led to a wrong structure whose model held."""
    screening = Screening(CHAIN, [storeys("displacement", (3,), 5.0)], known("k", "c"), guess(k=0.1))
    best = next(screening.candidates())
    assert screening.model is not None
    _, bottom = screening.model.fitted(best.unknowns, most=1000)
    np.testing.assert_allclose(bottom, best.unknowns, atol=0.01)


def within(times: float, record: Record) -> list[np.ndarray]:
    """Logarithms of stiffnesses over the true ones, of candidates with a misfit of up to so many times the least."""
    found = list(Screening(CHAIN, [record], known("k", "c"), guess(k=0.1)).candidates())
    return [np.log(one.parameters["k"] / K) for one in found if one.misfit <= times * found[0].misfit]


def test_what_noise_puts_behind_a_wrong_structure_is_a_candidate_too():
    """Of one velocity with 3 dB of noise the best fit has a spring twice as stiff; the right one is 7 % behind."""
    best, right, *_ = within(1.2, storeys("velocity", (2,), 3.0))
    assert abs(best).max() > 0.5
    assert abs(right).max() < 0.2


def test_a_spring_that_is_stiff_beside_all_others_makes_no_valleys():
    (stiff,) = within(1.2, storeys("displacement", (2,), 3.0))
    assert stiff[2] > 5.0


def test_starts_about_a_structure_that_fits_by_chance_find_the_right_one():
    """The wrong one makes almost what a single sensor saw; the right one lies beyond a hill."""
    wrong = Candidate({}, 1.0, unknowns=np.log(K * np.array([2.0, 0.4, 1.5])))
    _, best, *_ = Screening(CHAIN, [storeys("acceleration", (1,))], known("k"), guess()).others(wrong)
    assert best.misfit < 0.1
    np.testing.assert_allclose(best.parameters["k"], K, rtol=0.05)


def test_a_spring_that_the_spectra_do_not_tell_goes_with_the_others():
    """One that holds the structure like a rock may be any rock; the record in time tells more than its spectra."""
    best = Candidate({}, 0.0, unknowns=np.log(K * np.array([300.0, 1.0, 1.0])))
    alike, *_ = Screening(CHAIN, [storeys("acceleration", (3,))], known("k"), guess(k=10.0)).others(best)
    np.testing.assert_allclose(alike.parameters["k"] / K, 1.0, rtol=0.3)


def test_nothing_is_screened_without_anything_unknown():
    assert list(Screening(CHAIN, [storeys()], known("c"), guess()).candidates()) == []


def test_what_one_accelerometer_leaves_open_three_records_tell():
    structure = Structure(M, C, K, np.zeros(3))
    made = [measured(structure, response(dof), {"acceleration": (dof,)}, 30.0, dof).record for dof in (1, 2, 3)]
    even = {"m": M, "k": np.full(3, 1.5e5)}
    best = next(Screening(CHAIN, made, known("c", "k"), even).candidates())
    np.testing.assert_allclose(best.parameters["k"], K, rtol=0.05)


@pytest.mark.parametrize(
    ("first_frequency", "corner", "seed", "factor"),
    [(4.0, None, 0, 1e-6), (1.5, None, 1, 100.0), (4.0, 2.0, 2, 100.0)],
    ids=["", "slow", "wind"],
)
def test_resonances_tell_springs_where_nobody_measured_a_force(first_frequency, corner, seed, factor):
    made = ambient_record(first_frequency, 50.0, 60.0, 20.0, corner, seed=seed)
    assert what_acts(made.record) is None
    values = {kind: made.structure.parameters[kind].numpy() for kind in ("m", "c", "k")}
    unknown = {"m": values["m"], "c": np.full(3, np.nan), "k": np.full(3, np.nan), "loss": np.zeros(1)}
    guessed = {"m": values["m"], "k": np.full(3, factor * values["k"][0])}
    best = next(Screening(CHAIN, [made.record], unknown, guessed).candidates())
    np.testing.assert_allclose(best.parameters["k"], values["k"], rtol=0.2)
    assert np.all(np.abs(np.log(best.parameters["c"] / values["c"])) < np.log(3.0))


def test_spectra_hold_what_force_and_response_have_in_common():
    """Response over force is the structure's own frequency response, at its resonances and between them."""
    record = measure(small_chain("linear", 3), 60.0)
    spectra = spectra_under(record, what_acts(record))
    given = spectra.of_both[:, :, 0] / spectra.of_acting[:, 0, :]
    inside, expected = (spectra.omega > 2 * np.pi * 0.04) & (spectra.omega < 2 * np.pi * 0.45), []
    for omega in spectra.omega:
        dynamic = (15.0 + 1j * omega) * STRETCH.T @ STRETCH - 10.0 * omega**2 * np.eye(3)
        expected.append(-(omega**2) * np.linalg.inv(dynamic)[:, 2])
    error = np.abs(given / expected - 1.0)[inside]
    assert np.median(error) < 0.1


@cache
def shaken(frame: str) -> Record:
    """On ground that moves, without a force."""
    structure = chain_of({kind: torch.as_tensor(TRUE[kind]) for kind in "mck"}, Linear())
    time, phases = np.linspace(0.0, 20.0, 1001), np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, 170)
    lines = 2.0 * np.pi * np.linspace(0.5, 9.0, 170)
    shake = lambda t: np.cos(np.outer(t, lines) + phases).sum(1) / 20.0  # noqa: E731
    truth = simulate(structure, lambda t: np.zeros((len(t), 3)), time, substeps=4, ground=shake, frame=frame)
    return Record(**Noise(30.0).added_to(truth).measurable, unforced=np.ones(3, bool), frame=frame)


@pytest.mark.parametrize("frame", ["absolute", "relative"])
def test_an_earthquake_tells_stiffnesses_as_a_force_does(frame):
    even = {"m": M, "k": np.full(3, 1.0e5)}
    best = next(Screening(CHAIN, [shaken(frame).keep({"acceleration": [3]})], known("c", "k"), even).candidates())
    np.testing.assert_allclose(best.parameters["k"], K, rtol=0.05)


@pytest.mark.parametrize("way", ["braced", "shaken", "in doubt"])
def test_slopes_of_the_misfit_are_those_of_its_values(way):
    record, structure, doubts = storeys(), CHAIN, []
    free, stiffness = known("m", "c", "k"), 1.3 * guess()["k"]
    if way == "braced":
        structure, stiffness = braced(), np.resize(stiffness, 6)
        free |= {"c": np.full(6, np.nan), "k": np.where(np.arange(6) < 5, np.nan, 0.0)}
    elif way == "shaken":
        record = shaken("absolute")
    else:
        sensor, *_ = spectra_under(record, what_acts(record)).sensors
        cell = spectra_under(record, what_acts(record)).acting[0]
        doubts = [*doubts_about(sensor, record.step), *doubts_about(cell, record.step)]
    fit = LinearFit(record, LinearStructure(structure, free, stiffness), doubts)
    x = JointFit([fit]).start(guess()["m"], stiffness)
    x[fit.structure.count :] = 0.2 * np.random.default_rng(0).normal(size=len(doubts))
    slopes = fit.slopes(x)
    assert slopes.shape[-1] == len(x) == 3 + min(len(stiffness), 5) + 1 + len(doubts)
    for i, move in enumerate(1e-6 * np.eye(len(x))):
        rise = (fit.residual(x + move) - fit.residual(x - move)) / 2e-6
        np.testing.assert_allclose(slopes[..., i], rise, atol=1e-6 * np.abs(rise).max())


def stiffnesses(record: Record) -> np.ndarray:
    """Of the best structure, over the true ones."""
    even = {"m": M, "k": np.full(3, 2e5)}
    best = next(Screening(CHAIN, [record], {**TRUE, "k": np.full(3, np.nan)}, even).candidates())
    return best.parameters["k"] / K


def test_stiffnesses_are_found_from_the_samples_that_are_there():
    """Half of the first sensor's samples, four of five of the second's and a fifth of the third's in one piece."""
    record, rng, count = storeys(), np.random.default_rng(0), len(storeys().time)
    there = np.ones((count, 3), bool)
    there[:, 0] = rng.random(count) < 0.5
    there[:, 1] = np.arange(count) % 5 == 0
    there[int(0.5 * count) : int(0.7 * count), 2] = False
    channels = tuple(
        Channel(f"a{i + 1}", "acceleration", {i: 1.0}, record.time[there[:, i]], record.acceleration[there[:, i], i])
        for i in range(3)
    )
    columns = np.stack([channel.history(record.time) for channel in channels], axis=1)
    lost = replace(record, acceleration=columns, calibrated=channels)
    assert np.abs(stiffnesses(lost) - 1.0).max() < 0.1
    # Straight lines through what is missing lead astray.
    assert np.abs(stiffnesses(replace(lost, calibrated=())) - 1.0).max() > 0.3


def test_a_load_cell_that_misses_samples_tells_stiffnesses_too():
    record = storeys(duration=60.0)
    there = np.random.default_rng(3).random(len(record.time)) < 0.6
    cell = Channel("f", "force", {2: 1.0}, record.time[there], record.force[there, 2])
    force = record.force.copy()
    force[:, 2] = cell.history(record.time)
    assert np.abs(stiffnesses(replace(record, force=force, calibrated=(cell,))) - 1.0).max() < 0.05


def on_isolators(seed: int) -> tuple[Record, np.ndarray]:
    """Storeys and a slab on bilinear isolators under an earthquake (numpy, Runge-Kutta), and the storeys' springs.

    Hysteresis is that of Bouc and Wen with n = 1; accelerometers on the slab, the first floor and the roof, 40 dB.
    """
    rng, fine, step = np.random.default_rng(seed), 8, 0.01
    m, k, c = (
        np.array([95e3, 80e3, 80e3, 70e3]),
        np.array([3.2e6, 9.5e7, 8.2e7, 6.9e7]),
        np.array([4e4, 2.6e5, 2.2e5, 1.9e5]),
    )
    a, bend, rows = 1.9e7, 110.0, np.eye(4) - np.eye(4, k=-1)
    time = np.arange(0.0, 30.0, step / fine)
    frequency = np.linspace(0.3, 12.0, 300)
    shaken = np.cos(2.0 * np.pi * np.outer(time, frequency) + rng.uniform(0.0, 2.0 * np.pi, 300)).sum(1) / 300**0.5
    shaken *= 2.5 * np.minimum(1.0, time / 3.0) * np.exp(-np.maximum(0.0, time - 15.0) / 5.0)

    def rate(state: np.ndarray, ground: float) -> np.ndarray:
        u, v, z = state[:4], state[4:8], state[8]
        e, de = rows @ u, rows @ v
        force = k * e + c * de
        force[0] += z
        turned = a * de[0] - bend * (0.6 * abs(de[0]) * z + 0.4 * de[0] * abs(z))
        return np.concatenate((v, -(force @ rows) / m - ground, [turned]))

    state, found = np.zeros(9), []
    for i in range(0, len(time) - 2 * fine, 2):
        if i % fine == 0:
            found.append(rate(state, shaken[i])[4:8] + shaken[i])
        h = 2.0 * step / fine
        k1 = rate(state, shaken[i])
        k2 = rate(state + 0.5 * h * k1, shaken[i + 1])
        k3 = rate(state + 0.5 * h * k2, shaken[i + 1])
        k4 = rate(state + h * k3, shaken[i + 2])
        state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    seen = np.array(found)
    seen += 0.01 * seen.std(axis=0) * rng.standard_normal(seen.shape)
    seen[:, 2] = np.nan
    count = len(seen)
    nothing = np.full_like(seen, np.nan)
    record = Record(
        time[::fine][:count], nothing, nothing, seen, np.zeros_like(seen), ground_acceleration=shaken[::fine][:count],
        frame="absolute", unforced=np.ones(4, dtype=bool),
    )  # fmt: skip
    return record, k[1:]


@pytest.mark.parametrize("seed", [0, 1])
def test_what_stands_on_isolators_that_slip_is_found(seed: int):
    """No linear structure with springs of one size comes near: isolators are far softer, and no spring at all."""
    record, storeys = on_isolators(seed)
    nothing = np.full(4, np.nan)
    known = {"m": np.array([95e3, 80e3, 80e3, 70e3]), "c": nothing, "k": nothing, "loss": np.zeros(1)}
    guess = {"m": known["m"], "k": np.full(4, 6e5)}
    best = next(Screening(small_chain("linear", 4), [record], known, guess).candidates())
    assert best.misfit < HOPELESS
    assert abs(np.log(best.parameters["k"][1:] / storeys)).max() < np.log(2.0)
    assert best.parameters["k"][0] < 0.3 * storeys.min()
