"""Simulated records: noise and its seeds, repeated measurements, what the record says; and the paper's own signals."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from calls import refusal
from omegaconf import OmegaConf

from pinn_cli.cli.records import OF_THE_RUN
from pinn_cli.record.excitation import BandedNoise
from pinn_cli.record.response import QUANTITIES, Response
from pinn_cli.record.simulated import Noise, Simulated, averaged
from pinn_cli.record.simulation import Simulation
from pinn_cli.settings.instantiation import build
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing, VanDerPol
from pinn_cli.system.model_error import NoModelError, PerturbedModelError

CONF = Path(__file__).parents[2] / "conf" / "data" / "simulated.yaml"
SAMPLES = 2048
TIME = np.linspace(0.0, 60.0, SAMPLES)
SEEDS = {"displacement": 43810, "velocity": 13927, "acceleration": 2024, "force": 1234}
CHAIN = build_chain(3, Duffing(), m=10.0, c=1.0, k=15.0, kappa=100.0)
EXCITATION = BandedNoise(3, 20.0, 512, band=[0.05, 1.0], rms=1.0, dofs=[1, 3])


def response(ndof: int = 3) -> Response:
    """DOFs 1 and 3 carry a force."""
    waves = np.stack([(i + 1.0) * np.sin((i + 1.0) * TIME) + 0.5 for i in range(ndof)], axis=1)
    return Response(TIME, waves, 2.0 * waves, 3.0 * waves, waves * (np.arange(ndof) % 2 == 0))


def added(noise: Noise, repeat: int = 0, ndof: int = 3) -> dict[str, np.ndarray]:
    """Quantity to the noise (N, n) of one repeat."""
    clean = response(ndof)
    seen = noise.added_to(clean, repeat)
    return {quantity: getattr(seen, quantity) - getattr(clean, quantity) for quantity in QUANTITIES}


@pytest.mark.parametrize("snr_db", [50.0, 10.0, 0.0, -5])
def test_the_ratio_is_the_one_asked_for(snr_db):
    for quantity, noise in added(Noise(snr_db, seed=4)).items():
        power = np.mean(getattr(response(), quantity) ** 2, axis=0)
        forced = power > 0.0
        assert not noise[:, ~forced].any()
        measured = 10.0 * np.log10(power[forced] / np.mean(noise**2, axis=0)[forced])
        # The power of 2048 draws is known to 10 log10(1 + sqrt(2 / 2048)) = 0.13 dB.
        np.testing.assert_allclose(measured, snr_db, atol=0.5)


def test_a_channels_noise_does_not_depend_on_the_others():
    few, many = (added(Noise(20.0, seed=7), ndof=ndof)["velocity"] for ndof in (3, 6))
    np.testing.assert_allclose(few, many[:, :3], atol=1e-14)


def test_unknown_channels_get_none_and_the_signal_is_left_alone():
    clean = response()
    clean.displacement[:, 1] = np.nan
    before = clean.displacement.copy()
    noisy = Noise(10.0).added_to(clean)
    assert np.isnan(noisy.displacement[:, 1]).all()
    assert np.isfinite(noisy.displacement[:, [0, 2]]).all()
    np.testing.assert_array_equal(clean.displacement, before)
    assert Noise(snr_db=None).added_to(clean) is clean


@pytest.mark.parametrize(("seeds", "repeat"), [(None, 0), (None, 2), (SEEDS, 0)])
def test_a_seed_and_a_place_are_the_same_noise_for_ever(seeds, repeat):
    noise = added(Noise(20.0, 4, seeds, repeats=5), repeat)["acceleration"][:, 1]
    drawn = np.random.default_rng([4, 2, 1, *([repeat] if repeat else [])]).standard_normal(SAMPLES)
    drawn = drawn if seeds is None else np.random.RandomState(SEEDS["acceleration"] + 1).normal(size=SAMPLES)
    np.testing.assert_allclose(noise / noise.std(), drawn / drawn.std(), rtol=1e-9)


@pytest.mark.parametrize("seeds", [None, SEEDS], ids=["seed", "seeds"])
def test_streams_of_channels_quantities_and_repeats_are_independent(seeds):
    noises = [added(Noise(20.0, 5, seeds, repeats=4), repeat) for repeat in range(4)]
    rows = np.concatenate([x.T for each in noises for x in each.values()])
    rows = rows[rows.any(axis=1)]
    rows = rows / rows.std(axis=1, keepdims=True)
    assert len(rows) == 4 * 11
    assert np.max(np.abs(rows @ rows.T / SAMPLES - np.eye(len(rows)))) < 5.0 / np.sqrt(SAMPLES)


def test_shared_streams_are_shared_by_neighbours():
    noise = Noise(20.0, 0, SEEDS, repeats=3, repeat_streams="shared")
    for quantity in ("displacement", "velocity", "acceleration"):
        unit = np.stack([added(noise, repeat)[quantity] for repeat in range(3)])
        unit /= np.sqrt(np.mean(getattr(response(), quantity) ** 2, axis=0) / 100.0)
        # Channel 2 of repeat 1 has the noise of channel 1 of repeat 2.
        np.testing.assert_allclose(unit[0, :, 1], unit[1, :, 0], atol=1e-9)
        np.testing.assert_allclose(unit[0, :, 2], unit[2, :, 0], atol=1e-9)
        drawn = np.random.RandomState(SEEDS[quantity] + 3).standard_normal(SAMPLES)
        np.testing.assert_allclose(unit[1, :, 2], drawn, atol=1e-9)


@pytest.mark.parametrize("repeats", [2, 5, 20])
def test_the_noise_of_the_mean(repeats):
    """Told by the scatter, found in the mean itself, and sigma / sqrt(R)."""
    mean, scatter = Noise(10.0, seed=1, repeats=repeats).measured(response())
    assert Noise(20.0).measured(response())[1] is None
    blind = replace(mean, velocity=np.where([False, True, False], np.nan, mean.velocity))
    np.testing.assert_array_equal(np.isnan(averaged([blind, blind])[1].noise_of_mean("velocity")), [0, 1, 0])
    for quantity in QUANTITIES:
        clean = getattr(response(), quantity)
        noisy = clean.any(axis=0)
        expected = np.sqrt(np.mean(clean[:, noisy] ** 2, axis=0) / 10.0 / repeats)
        found = (getattr(mean, quantity) - clean)[:, noisy].std(axis=0)
        # A standard deviation from d degrees of freedom scatters by 1 / sqrt(2 d): here by four of those.
        np.testing.assert_allclose(found, expected, rtol=4.0 / np.sqrt(2.0 * SAMPLES))
        told = scatter.noise_of_mean(quantity)[noisy]
        np.testing.assert_allclose(told, expected, rtol=4.0 / np.sqrt(2.0 * scatter.freedom))


def measured(noise: Noise, hold: str = "exact"):
    parts = {"excitation": EXCITATION, "simulation": Simulation(20.0, 512, hold), "noise": noise}
    node = OmegaConf.load(CONF)
    for name in OF_THE_RUN:
        del node[name]
    source = build(node, "data", **parts)
    assert source == Simulated(**parts)
    return source.measure(CHAIN)


@pytest.mark.parametrize(("hold", "intersample"), [("exact", "band_limited"), ("zero_order", "zero_order_hold")])
def test_every_sensor_exists_and_the_truth_is_clean(hold, intersample):
    measurements = measured(Noise(20.0), hold)
    record, truth = measurements.record, measurements.truth
    assert record.intersample == intersample
    assert all(record.sensors(quantity).all() for quantity in ("displacement", "velocity", "acceleration"))
    assert record.sensors("force").tolist() == [True, False, True]
    assert record.unforced.tolist() == [False, True, False]
    assert not record.force[:, 1].any()
    u, v, a = truth.response.displacement, truth.response.velocity, truth.response.acceleration
    np.testing.assert_allclose(CHAIN.external_force(u, v, a), truth.response.force, atol=1e-12)
    assert truth.parameters["kappa"].tolist() == [100.0] * 3


def test_a_record_of_repeats_is_their_mean_and_knows_their_scatter():
    noise = Noise(20.0, 4, repeats=6)
    record = measured(noise).record
    mean, scatter = noise.measured(measured(Noise(None)).truth.response)
    for quantity in QUANTITIES:
        np.testing.assert_array_equal(getattr(record, quantity), getattr(mean, quantity))
        np.testing.assert_array_equal(record.repeats.square[quantity], scatter.square[quantity])
    assert record.keep({"velocity": [1]}).repeats is record.repeats


@pytest.mark.parametrize(
    ("setting", "settings"),
    [
        ("noise.snr_db", {"snr_db": "50 dB"}),
        ("seed", {"seed": -1}),
        ("noise.seeds", {"seeds": {"force": 1}}),
        ("noise.seeds", {"seeds": {**SEEDS, "strain": 5}}),
        ("noise.seeds.force", {"seeds": {**SEEDS, "force": 0.5}}),
        ("noise.repeats", {"snr_db": 20.0, "repeats": 0}),
        ("noise.repeats", {"repeats": 5}),
        ("noise.repeat_streams", {"snr_db": 20.0, "repeats": 5, "repeat_streams": "same"}),
        ("noise.repeat_streams", {"snr_db": 20.0, "repeats": 5, "repeat_streams": "shared"}),
    ],
)
def test_illegal_settings_are_named(setting, settings):
    assert refusal(Noise, **settings).startswith(f"{setting}=")


NO_ERROR = NoModelError()
CASES = {
    "sr_6dof": (6, 60.0, Duffing(), NO_ERROR),
    "sr_20dof": (20, 60.0, Duffing(), NO_ERROR),
    "sr_6dof_perturbed": (6, 60.0, Duffing(), PerturbedModelError(seed=43810, draws="authors")),
    "sp_5dof": (5, 60.0, Duffing(), NO_ERROR),
    "sp_5dof_van_der_pol": (5, 60.0, VanDerPol(), NO_ERROR),
    "sp_5dof_perturbed": (5, 60.0, Duffing(), PerturbedModelError(seed=43810, draws="authors", seed_stride=100)),
    "pe_2dof": (2, 240.0, Duffing(), NO_ERROR),
    "pe_2dof_van_der_pol": (2, 240.0, VanDerPol(), NO_ERROR),
}
COEFFICIENT = {"duffing": {"kappa": 100.0}, "van_der_pol": {"mu": 0.75}}


def largest_relative_error(x: np.ndarray, reference: np.ndarray) -> float:
    return float(np.max(np.abs(x - reference)) / np.max(np.abs(reference)))


@pytest.mark.parametrize("case", CASES)
def test_every_array_is_reproduced(shared, case):
    ndof, duration, nonlinearity, model_error = CASES[case]
    nominal = build_chain(ndof, nonlinearity, m=10.0, c=1.0, k=15.0, **COEFFICIENT[nonlinearity.name])
    structure, _ = model_error.structures(nominal)
    simulation = Simulation(duration, 4096, hold="zero_order")
    excitation = BandedNoise(ndof, duration, 4096, band=[0.05, 1.0], rms=None, dofs=[1], seed=43810, phases="authors")
    response = simulation.run(structure, excitation.force)

    reference = dict(np.load(shared / "data" / "reference_signals" / f"{case}.npz"))
    ours = {"time": response.time, **{quantity: getattr(response, quantity) for quantity in QUANTITIES}}
    ours |= {name: value.numpy() for name, value in structure.parameters.items()}
    for snr_db in (50, 20, 10):
        noisy = Noise(snr_db, seeds=SEEDS).added_to(response)
        ours |= {f"{quantity}_snr{snr_db}": getattr(noisy, quantity) for quantity in QUANTITIES}
    for name, array in reference.items():
        if name in ("kappa", "mu") and name not in ours:
            assert not array.any()
        else:
            assert largest_relative_error(ours[name], array) < 1e-9, name
