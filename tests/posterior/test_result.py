"""The table of diagnostics, what is said of bad draws, and draws of the measured force."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from fake_posteriors import make_samples
from scipy.signal import lfilter

from pinn_cli.posterior.posterior import (
    PREDICTED_DRAWS,
    PREDICTED_SAMPLES,
    PosteriorSamples,
    diagnose,
    force_predictive,
    verdict,
)


def samples(draws: np.ndarray, **changes: object) -> PosteriorSamples:
    """Of c_1 as given, and of k_2 and the noise as a good sampler would draw them."""
    made = make_samples(("c_1", "k_2"), *draws.shape, force_dofs=np.array([3]), **changes)
    return replace(made, draws=np.stack([draws, made.draws[..., 1]], axis=-1))


def walk(step: float) -> np.ndarray:
    """An autoregression of variance one that forgets at the rate of ``step``."""
    noise = np.random.default_rng(2).standard_normal((4, 1000))
    noise[:, 1:] *= np.sqrt(1 - (1 - step) ** 2)
    return lfilter([1.0], [1.0, step - 1.0], noise)


def test_good_draws():
    found = samples(np.random.default_rng(0).normal(1.0, 0.1, (4, 1000)))
    table = diagnose(found)
    assert list(table["parameter"]) == ["c_1", "k_2", "sigma_force_3"]
    row = table.iloc[0]
    assert row["mean"] == pytest.approx(1.0, abs=0.01)
    assert row["std"] == pytest.approx(0.1, rel=0.05)
    assert (row["lower_90"], row["upper_90"]) == pytest.approx((1 - 0.1645, 1 + 0.1645), abs=0.01)
    assert row["r_hat"] == pytest.approx(1.0, abs=0.005)
    assert row["ess_bulk"] == pytest.approx(4000, rel=0.15)
    assert row["mcse_mean"] == pytest.approx(0.1 / np.sqrt(4000), rel=0.15)
    assert verdict(table, found) == []


def test_chains_that_disagree_crawl_or_do_not_move():
    found = samples(np.random.default_rng(0).standard_normal((4, 1000)) + np.arange(4)[:, None])
    lines = verdict(diagnose(found), found)
    assert all(line.startswith("c_1: ") for line in lines)
    assert "posterior.draws" in lines[0]
    found = samples(walk(0.02))
    lines = verdict(diagnose(found), found)
    assert any("effective draws" in line and "posterior.draws" in line for line in lines)
    few = samples(np.random.default_rng(0).standard_normal((4, 50)))
    assert {line.split(":")[0] for line in verdict(diagnose(few), few)} == {"c_1", "k_2", "sigma_force_3"}
    found = samples(np.full((4, 1000), 3.0))
    (line,) = verdict(diagnose(found), found)
    assert line.startswith("c_1 does not move")


def test_divergences():
    found = samples(np.random.default_rng(0).standard_normal((4, 1000)))
    diverging = np.zeros((4, 1000), dtype=bool)
    diverging[1, 7:9] = True
    found = replace(found, statistics={"diverging": diverging})
    (line,) = verdict(diagnose(found), found)
    assert line.startswith("2 of 4000 draws diverged")
    assert "posterior.target_accept" in line


def test_one_chain_is_judged_by_its_halves_and_the_closed_form_not_at_all():
    good = samples(np.random.default_rng(0).standard_normal((1, 2001)))
    assert verdict(diagnose(good), good) == []
    drifting = samples(np.linspace(0.0, 3.0, 2000)[None] + np.random.default_rng(0).standard_normal((1, 2000)))
    assert diagnose(drifting)["r_hat"][0] > 1.1
    found = samples(np.random.default_rng(0).standard_normal((1, 50)), method="laplace", statistics={})
    table = diagnose(found)
    assert table[["r_hat", "ess_bulk", "ess_tail"]].isna().all(axis=None)
    assert table["mcse_mean"][0] == pytest.approx(1 / np.sqrt(50), rel=0.3)
    assert verdict(table, found) == []


SAMPLES, DOFS = 5000, 2


def _likelihoods(samples):
    force = np.sin(np.linspace(0.0, 60.0, SAMPLES))[:, None] * np.arange(1, DOFS + 1)
    slope = np.zeros((SAMPLES, DOFS, len(samples.names)))
    peak = samples.draws.mean(axis=(0, 1))
    return SimpleNamespace(force=force, force_by_parameter=slope, marginal=SimpleNamespace(peak=peak))


@pytest.mark.parametrize("repeats", [1, 4])
def test_noise_is_that_of_the_mean_of_the_repeats(repeats):
    samples = make_samples(forces=DOFS)
    likelihoods = _likelihoods(samples)
    predicted = force_predictive(likelihoods, samples, seed=0, repeats=repeats)
    spread = np.std(predicted.force - likelihoods.force[predicted.samples], axis=(0, 1, 2))
    assert spread == pytest.approx(0.13 / np.sqrt(repeats), rel=0.02)


def test_a_drawn_parameter_moves_the_force():
    samples = make_samples(("k_1",), sigma_force=np.zeros((4, 200, 1)))
    likelihoods = _likelihoods(samples)
    likelihoods.force_by_parameter[:, 0, 0] = 3.0
    predicted = force_predictive(likelihoods, samples, seed=0)
    moved = predicted.force - likelihoods.force[predicted.samples][:, :1]
    expected = 3.0 * (samples.draws[:, predicted.draws, 0] - likelihoods.marginal.peak)
    np.testing.assert_allclose(moved, np.broadcast_to(expected[..., None, None], moved.shape), atol=1e-12)


@pytest.mark.parametrize("chains", [1, 4])
def test_it_is_thinned(chains):
    samples = make_samples(chains=chains, draws=300)
    predicted = force_predictive(_likelihoods(samples), samples, seed=0)
    assert predicted.force.shape[0] * predicted.force.shape[1] == PREDICTED_DRAWS
    assert PREDICTED_SAMPLES / 2 < len(predicted.samples) <= PREDICTED_SAMPLES
    assert predicted.draws[[0, -1]].tolist() == [0, 299]
