"""Linear chains that make of the measured force what the sensors saw, from guesses that are far off."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from ambient_records import ambient_record
from independent_records import IndependentRecord, frame_record

from pinn_cli.record.noise import Noise
from pinn_cli.record.record import Record
from pinn_cli.record.simulation import simulate
from pinn_cli.scheme.linear_fit import LinearFit, LinearStructure, spectra_under, what_acts
from pinn_cli.scheme.screening import screened
from pinn_cli.system.building import chain_of
from pinn_cli.system.connection import Linear

# Row i: which displacements stretch connection i of a chain of three.
STRETCH = np.eye(3) - np.eye(3, k=-1)


def linear(**settings) -> IndependentRecord:
    return frame_record(rate=100.0, duration=20.0, cubic=False, **settings)


def known(made: IndependentRecord, *unknown: str) -> dict[str, np.ndarray]:
    return {kind: np.where(kind in unknown, np.nan, getattr(made.structure, kind)) for kind in ("m", "c", "k")}


def guess(made: IndependentRecord, **factors: float) -> dict[str, np.ndarray]:
    uneven = np.array([1.0, 1.15, 0.9])
    return {kind: factors.get(kind, 1.0) * uneven * getattr(made.structure, kind) for kind in ("m", "k")}


@pytest.mark.parametrize("factor", [0.1, 1.0, 10.0])
def test_stiffnesses_come_out_from_a_guess_a_decade_off(factor):
    made = linear()
    best = screened(made.record, STRETCH, known(made, "k"), guess(made, k=factor))[0]
    np.testing.assert_allclose(best.parameters["k"], made.structure.k, rtol=0.03)
    assert best.misfit < 0.1
    for kind in ("m", "c"):
        np.testing.assert_array_equal(best.parameters[kind], getattr(made.structure, kind))


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_from_one_sensor_too(factor):
    made = linear(sensors=(("velocity", (1,)),))
    best = screened(made.record, STRETCH, known(made, "k"), guess(made, k=factor))[0]
    np.testing.assert_allclose(best.parameters["k"], made.structure.k, rtol=0.05)


@pytest.mark.parametrize("factor", [0.2, 3.0])
def test_masses_come_out_beside_known_stiffnesses(factor):
    made = linear()
    best = screened(made.record, STRETCH, known(made, "m"), guess(made, m=factor))[0]
    np.testing.assert_allclose(best.parameters["m"], made.structure.m, rtol=0.03)


def test_masses_and_stiffnesses_and_dampers_come_out_together():
    """The measured force says how heavy all is."""
    made = linear()
    best = screened(made.record, STRETCH, known(made, "m", "c", "k"), guess(made, k=10.0, m=2.0))[0]
    np.testing.assert_allclose(best.parameters["k"], made.structure.k, rtol=0.05)
    np.testing.assert_allclose(best.parameters["m"], made.structure.m, rtol=0.05)
    np.testing.assert_allclose(best.parameters["c"], made.structure.c, rtol=0.6)


def test_candidates_are_sorted_and_distinct():
    made = linear()
    found = screened(made.record, STRETCH, known(made, "k"), guess(made, k=10.0))
    misfits = [candidate.misfit for candidate in found]
    assert misfits == sorted(misfits)
    for i, one in enumerate(found):
        for other in found[:i]:
            assert np.abs(np.log(one.parameters["k"] / other.parameters["k"])).max() > 0.02


def test_nothing_is_screened_without_anything_unknown():
    made = linear()
    assert screened(made.record, STRETCH, known(made, "c"), guess(made)) == []


@pytest.mark.parametrize("factor", [1e-6, 100.0])
@pytest.mark.parametrize(
    ("first_frequency", "corner", "seed"), [(4.0, None, 0), (1.5, None, 1), (4.0, 2.0, 2)], ids=["", "slow", "wind"]
)
def test_resonances_tell_springs_where_nobody_measured_a_force(first_frequency, corner, seed, factor):
    made = ambient_record(first_frequency, 50.0, 60.0, 20.0, corner, seed=seed)
    assert what_acts(made.record) is None
    values = {kind: made.structure.parameters[kind].numpy() for kind in ("m", "c", "k")}
    unknown = {"m": values["m"], "c": np.full(3, np.nan), "k": np.full(3, np.nan)}
    guessed = {"m": values["m"], "k": np.full(3, factor * values["k"][0])}
    best, *_ = screened(made.record, STRETCH, unknown, guessed)
    np.testing.assert_allclose(best.parameters["k"], values["k"], rtol=0.2)
    assert np.all(np.abs(np.log(best.parameters["c"] / values["c"])) < np.log(3.0))


# The chain with a brace from the ground to the second mass, a tie from the first to the third, and a bare damper.
BRACED = np.vstack([STRETCH, [[0.0, 1.0, 0.0], [-1.0, 0.0, 1.0], [0.8, 0.0, -0.6]]])


@pytest.mark.parametrize("stretch", [STRETCH, BRACED], ids=["chain", "braced"])
def test_slopes_of_the_misfit_are_those_of_its_values(stretch):
    made = linear(sensors=(("acceleration", (1, 3)), ("displacement", (2,))))
    free, count = known(made, "m", "c", "k"), len(stretch)
    stiffness = 1.3 * np.resize(guess(made)["k"], count)
    free |= {"c": np.full(count, np.nan), "k": np.where(np.arange(count) < 5, np.nan, 0.0)}
    fit = LinearFit(made.record, LinearStructure(stretch, free, stiffness))
    x = fit.structure.start(guess(made)["m"], stiffness)
    slopes = fit.slopes(x)
    assert slopes.shape[-1] == len(x) == 3 + min(count, 5) + 1
    for i, move in enumerate(1e-6 * np.eye(len(x))):
        ends = [fit.residual(x + s * move) for s in (1.0, -1.0)]
        rise = (ends[0] - ends[1]) / 2e-6
        np.testing.assert_allclose(slopes[..., i], rise, atol=1e-6 * np.abs(rise).max())


def test_spectra_hold_what_force_and_response_have_in_common():
    """Response over force is the structure's own frequency response, at its resonances and between them."""
    made = linear(snr_db=60.0)
    spectra, s = spectra_under(made.record, what_acts(made.record)), made.structure
    given = spectra.of_both[:, :, 0] / spectra.of_acting[:, 0, :]
    below = np.eye(3) - np.eye(3, k=-1)
    expected = []
    for omega in spectra.omega:
        dynamic = below.T @ np.diag(s.k + 1j * omega * s.c) @ below - omega**2 * np.diag(s.m)
        expected.append(-(omega**2) * np.linalg.inv(dynamic)[:, 2])
    inside = (spectra.omega > 2 * np.pi * 0.7) & (spectra.omega < 2 * np.pi * 19.0)
    error = np.abs(given - expected)[inside]
    assert np.median(error / np.abs(expected)[inside]) < 0.1


@pytest.mark.parametrize("frame", ["absolute", "relative"])
def test_an_earthquake_tells_stiffnesses_as_a_force_does(frame):
    masses, springs = np.array([2000.0, 2000.0, 1500.0]), np.array([8.0e6, 7.2e6, 5.6e6])
    values = {"m": masses, "c": 0.04 * np.sqrt(masses * springs), "k": springs}
    structure = chain_of({kind: torch.as_tensor(value) for kind, value in values.items()}, Linear())
    time, phases = np.linspace(0.0, 20.0, 2001), np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, 400)
    lines = 2.0 * np.pi * np.linspace(0.5, 20.0, 400)
    shake = lambda t: np.cos(np.outer(t, lines) + phases).sum(1) / 20.0  # noqa: E731
    truth = simulate(structure, lambda t: np.zeros((len(t), 3)), time, substeps=4, ground=shake, frame=frame)
    record = Record(**Noise(30.0).added_to(truth).measurable, unforced=np.ones(3, bool), frame=frame)
    free = {"m": masses, "c": np.full(3, np.nan), "k": np.full(3, np.nan)}
    guess = {"m": masses, "k": np.full(3, 1.0e5)}
    best = screened(record.keep({"acceleration": [3]}), np.eye(3) - np.eye(3, k=-1), free, guess)[0]
    np.testing.assert_allclose(best.parameters["k"], springs, rtol=0.05)
    free |= {"m": np.full(3, np.nan)}
    fit = LinearFit(record, LinearStructure(np.eye(3) - np.eye(3, k=-1), free, guess["k"]))
    x = fit.structure.start(1.2 * masses, 0.9 * springs)
    residual, slopes = fit.residual(x), fit.slopes(x)
    for i, step in enumerate(1e-6 * np.eye(len(x))):
        numerical = (fit.residual(x + step) - fit.residual(x - step)) / 2e-6
        np.testing.assert_allclose(slopes[..., i], numerical, atol=1e-6 * np.abs(numerical).max())
    assert residual.shape[-1] == 1
