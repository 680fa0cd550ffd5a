"""Draws of the measured force: what they scatter about, and how much."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from fake_posteriors import make_samples

from pinn_cli.posterior.result import PREDICTED_DRAWS, PREDICTED_SAMPLES, force_predictive

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
