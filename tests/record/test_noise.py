from __future__ import annotations

import math

import numpy as np
import pytest
from refusals import refusal

from pinn_cli.record.noise import Noise, add_noise
from pinn_cli.record.response import QUANTITIES, Response

TIME = np.linspace(0.0, 60.0, 4096)


def response(ndof: int = 3) -> Response:
    waves = np.stack([(i + 1.0) * np.sin((i + 1.0) * TIME) + 0.5 for i in range(ndof)], axis=1)
    force = np.zeros((4096, ndof))
    force[:, 0] = np.cos(TIME)
    return Response(TIME, waves, 2.0 * waves, 3.0 * waves, force)


def added(noisy: Response, quantity: str) -> np.ndarray:
    return getattr(noisy, quantity) - getattr(response(noisy.force.shape[1]), quantity)


@pytest.mark.parametrize("snr_db", [50.0, 10.0, 0.0, -5])
def test_the_ratio_is_the_one_asked_for(snr_db):
    noisy = add_noise(response(), snr_db, seed=4)
    for quantity in QUANTITIES:
        power = np.mean(getattr(response(), quantity) ** 2, axis=0)
        noise = np.mean(added(noisy, quantity) ** 2, axis=0)
        forced = power > 0.0
        measured = 10.0 * np.log10(power[forced] / noise[forced])
        # The power of 4096 draws is known to 10 log10(1 + sqrt(2 / 4096)) = 0.1 dB.
        np.testing.assert_allclose(measured, snr_db, atol=0.4)


def test_the_noise_is_white_and_gaussian():
    noise = added(add_noise(response(), 20.0), "velocity")[:, 0]
    noise = noise / noise.std()
    assert abs(np.mean(noise[1:] * noise[:-1])) < 0.06
    assert np.mean(noise**4) == pytest.approx(3.0, abs=0.35)


def test_channels_and_quantities_and_seeds_differ():
    drawn = [
        added(add_noise(response(), 20.0, seed=seed), quantity).T for seed in (0, 1) for quantity in QUANTITIES[:3]
    ]
    correlation = np.corrcoef(np.concatenate(drawn))
    assert np.max(np.abs(correlation - np.eye(len(correlation)))) < 0.1


def test_a_channels_noise_does_not_depend_on_the_others():
    np.testing.assert_allclose(
        add_noise(response(3), 20.0, seed=7).velocity, add_noise(response(6), 20.0, seed=7).velocity[:, :3]
    )


def test_unforced_dofs_and_unknown_channels_get_none():
    clean = response()
    clean.displacement[:, 1] = np.nan
    noisy = add_noise(clean, 10.0)
    assert not noisy.force[:, 1:].any()
    assert np.isnan(noisy.displacement[:, 1]).all()
    assert np.isfinite(noisy.displacement[:, [0, 2]]).all()


def test_no_ratio_no_noise_and_the_signal_is_left_alone():
    clean = response()
    assert Noise(snr_db=None).added_to(clean) is clean
    before = clean.velocity.copy()
    Noise(snr_db=10.0).added_to(clean)
    np.testing.assert_array_equal(clean.velocity, before)


def test_a_seed_and_a_place_are_the_same_noise_for_ever():
    noise = added(add_noise(response(), 20.0, seed=4), "acceleration")[:, 1]
    drawn = np.random.default_rng([4, 2, 1]).standard_normal(4096)
    np.testing.assert_allclose(noise / noise.std(), drawn / drawn.std(), rtol=1e-9)


def test_authors_seeds_are_legacy_generators_counted_up():
    seeds = {"displacement": 1, "velocity": 2, "acceleration": 3, "force": 4}
    noise = added(Noise(20.0, seeds=seeds).added_to(response()), "acceleration")[:, 2]
    drawn = np.random.RandomState(5).normal(size=4096)
    np.testing.assert_allclose(noise / noise.std(), drawn / drawn.std(), rtol=1e-9)


@pytest.mark.parametrize(
    ("setting", "settings"),
    [
        ("noise.snr_db", {"snr_db": math.inf}),
        ("noise.snr_db", {"snr_db": math.nan}),
        ("noise.snr_db", {"snr_db": "50 dB"}),
        ("noise.snr_db", {"snr_db": True}),
        ("seed", {"seed": -1}),
        ("seed", {"seed": None}),
        ("noise.seeds", {"seeds": {"force": 1}}),
        ("noise.seeds", {"seeds": {"displacement": 1, "velocity": 2, "acceleration": 3, "force": 4, "strain": 5}}),
        ("noise.seeds", {"seeds": 43810}),
        ("noise.seeds.force", {"seeds": {"displacement": 1, "velocity": 2, "acceleration": 3, "force": 0.5}}),
    ],
)
def test_illegal_settings_are_named(setting, settings):
    assert refusal(Noise, **settings).startswith(f"{setting}=")
