"""Sensor noise read off a record, and the features' own projection."""

import numpy as np
import pytest
import torch
from small_problems import QUANTITIES, measured, small_chain

from pinn_cli.network.fourier import Fourier
from pinn_cli.network.spline import Spline
from pinn_cli.training.noise_model import FeatureProjection, NoiseModel, first_output, output_features


@pytest.fixture(scope="module")
def measurements():
    return measured(small_chain(), snr_db=25.0, duration=24.0, samples=2049)


@pytest.mark.parametrize("continuity", ["exact", "penalised"])
@pytest.mark.parametrize("kind", [Spline, Fourier])
def test_a_projection_keeps_what_features_can_be(measurements, kind, continuity):
    network = kind(continuity=continuity).build(measurements.record)
    segments = network.segments(torch.as_tensor(measurements.record.time))
    output, features = first_output(network, segments), output_features(network, segments)[0]
    generator = torch.Generator().manual_seed(0)
    weights = torch.randn(network.count, 2, generator=generator, dtype=torch.float64)
    projection, grouped = FeatureProjection(output, features), features @ weights[output.feature]
    values = output.scatter(grouped)
    scale = float(values.abs().max())
    np.testing.assert_allclose(projection.residual(values), 0.0, atol=1e-5 * scale)
    np.testing.assert_allclose(projection.sum_of_squares(grouped), values.square().sum(0), rtol=1e-6)


def test_a_projection_of_white_noise_keeps_a_share_of_features_over_samples(measurements):
    network = Spline(intervals=100).build(measurements.record)
    segments = network.segments(torch.as_tensor(measurements.record.time))
    white = torch.as_tensor(np.random.default_rng(0).normal(size=(2049, 20)))
    found = FeatureProjection(segments, segments.displacement).sum_of_squares(segments.gather(white))
    assert found.mean() == pytest.approx(105, rel=0.1)
    rest = FeatureProjection(segments, segments.displacement).residual(white)
    np.testing.assert_allclose(found + (rest**2).sum(0), white.square().sum(0), rtol=1e-6)


def test_weights_are_inverse_variances():
    levels = {q: np.array([0.5 * (i + 1), np.nan]) for i, q in enumerate(QUANTITIES)}
    noise = NoiseModel(levels, np.array([0.3, np.nan]), 0.4, 1.0)
    np.testing.assert_allclose(noise.physics_variance, [0.25, 0.16])
    for i, quantity in enumerate(QUANTITIES):
        np.testing.assert_allclose(noise.observation_weight(quantity, np.ones(2)), [1.0 / (0.5 * (i + 1)) ** 2, 0.0])
    np.testing.assert_allclose(
        noise.observation_weight("observer", np.array([10.0, 10.0])), [1 / (1.5**2 + 0.0025), 0.0]
    )
