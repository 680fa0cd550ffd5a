"""Normal equations whose parameters are known: they stay, and weights are uncertain about them and by them."""

from __future__ import annotations

import numpy as np

from pinn_cli.training.band.diagonals import Diagonals
from pinn_cli.training.band.known_border import KnownBorderSystem


def test_parameters_stay_and_their_covariance_counts():
    random = np.random.default_rng(0)
    matrix = np.diag(np.arange(2.0, 8.0)) + np.diag(np.full(5, 0.5), 1) + np.diag(np.full(5, 0.5), -1)
    band = np.vstack((np.diag(matrix), np.append(np.diag(matrix, -1), 0.0)))
    border, root = random.standard_normal((6, 2)), random.standard_normal((2, 2))
    covariance = root @ root.T + np.eye(2)
    gradient = random.standard_normal(6)
    system = KnownBorderSystem(Diagonals.of_band(band), border, np.eye(2), gradient, np.ones(2), covariance=covariance)
    factor = system.factor()
    weights, parameters = factor.step(system, np.full(2, -np.inf))
    assert np.array_equal(parameters, np.zeros(2))
    assert np.allclose(weights, -np.linalg.solve(matrix, gradient))
    assert np.allclose(factor.corner_covariance, covariance)
    drawn, told = factor.draws(random.standard_normal((8, 200_000)))
    moved = np.linalg.solve(matrix, border)
    assert np.allclose(np.cov(told), covariance, rtol=0.05, atol=0.05)
    assert np.allclose(np.cov(drawn), np.linalg.inv(matrix) + moved @ covariance @ moved.T, atol=0.05)
