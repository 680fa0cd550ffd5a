"""Band-with-border solves against dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest

from pinn_cli.training.bordered import BorderedSystem

# Half-width, size, border: diagonal, narrow, size no multiple of the width, band as wide as the matrix.
SHAPES = [(0, 7, 0), (0, 7, 2), (1, 9, 3), (2, 23, 0), (3, 24, 1), (5, 31, 4), (7, 8, 2), (4, 4, 0), (1, 1, 1)]


def random_system(half_width: int, size: int, border: int) -> tuple[BorderedSystem, np.ndarray]:
    """A positive definite system whose diagonal spans eight decades, and the same as a dense matrix."""
    rng = np.random.default_rng([half_width, size, border])
    offset = np.subtract.outer(np.arange(size), np.arange(size))
    whole = np.zeros((size + border, size + border))
    lower = np.where((offset >= 0) & (offset <= half_width), rng.normal(size=(size, size)), 0.0)
    whole[:size, :size] = lower @ lower.T + 0.3 * np.eye(size)
    whole[:size, size:] = 0.1 * rng.normal(size=(size, border))
    whole[size:, :size] = whole[:size, size:].T
    whole[size:, size:] = np.eye(border) + whole[size:, :size] @ np.linalg.solve(
        whole[:size, :size], whole[:size, size:]
    )
    scale = 10.0 ** rng.uniform(-2.0, 2.0, size + border)
    whole *= scale[:, None] * scale
    gradient = rng.normal(size=size + border) * scale
    width = min(half_width, size - 1)
    band = np.zeros((half_width + 1, size))
    for k in range(width + 1):
        band[k, : size - k] = np.diag(whole[:size, :size], -k)
    corner = whole[size:, size:]
    return BorderedSystem(band, whole[:size, size:], corner, gradient[:size], gradient[size:]), whole


@pytest.mark.parametrize(("half_width", "size", "border"), SHAPES)
def test_step(half_width, size, border):
    system, whole = random_system(half_width, size, border)
    expected = -np.linalg.solve(whole, np.concatenate((system.gradient, system.corner_gradient)))
    step = system.factor().step(system)
    assert [x.shape for x in step] == [(size,), (border,)]
    np.testing.assert_allclose(np.concatenate(step), expected, rtol=1e-8)


@pytest.mark.parametrize(("half_width", "size", "border"), SHAPES)
def test_log_determinant(half_width, size, border):
    system, whole = random_system(half_width, size, border)
    assert system.factor().log_determinant == pytest.approx(np.linalg.slogdet(whole)[1], abs=1e-8)


@pytest.mark.parametrize(("half_width", "size", "border"), SHAPES)
def test_corner_covariance_is_the_inverse_of_the_whole(half_width, size, border):
    system, whole = random_system(half_width, size, border)
    expected = np.linalg.inv(whole)[size:, size:]
    given, scale = system.factor().corner_covariance, np.sqrt(np.diag(expected))
    np.testing.assert_allclose(given / scale / scale[:, None], expected / scale / scale[:, None], atol=1e-8)


@pytest.mark.parametrize(("half_width", "size", "border"), SHAPES)
def test_inverse_band_is_the_inverse_of_the_band_alone(half_width, size, border):
    system, whole = random_system(half_width, size, border)
    expected, given = np.linalg.inv(whole[:size, :size]), system.factor().inverse_band()
    scale = np.sqrt(np.diag(expected))
    assert given.shape == system.band.shape
    for k in range(min(half_width + 1, size)):
        off = scale[k:] * scale[: size - k]
        np.testing.assert_allclose(given[k, : size - k] / off, np.diag(expected, -k) / off, atol=1e-8)


@pytest.mark.parametrize("damping", [1e-3, 10.0])
def test_damping_shortens_the_step_and_does_not_turn_it(damping):
    system, whole = random_system(5, 31, 4)
    free, damped = (np.concatenate(system.factor(x).step(system)) for x in (0.0, damping))
    gradient, scale = np.concatenate((system.gradient, system.corner_gradient)), np.sqrt(np.diag(whole))
    assert np.linalg.norm(damped * scale) < np.linalg.norm(free * scale)
    assert gradient @ damped < 0


def test_damping_scales_the_diagonal():
    system, whole = random_system(3, 24, 0)
    damped = whole + 0.5 * np.diag(np.diag(whole))
    expected = -np.linalg.solve(damped, system.gradient)
    np.testing.assert_allclose(system.factor(0.5).step(system)[0], expected, rtol=1e-8)


@pytest.mark.parametrize("spoil", ["indefinite band", "indefinite corner", "zero", "nan"])
def test_what_is_not_positive_definite_has_no_factor(spoil):
    system, _ = random_system(2, 10, 2)
    if spoil == "indefinite band":
        system.band[1] = 10.0 * np.sqrt(system.band[0])[0] * np.abs(system.band[1]).max()
    elif spoil == "indefinite corner":
        system.corner[:] -= 10.0 * np.diag(np.diag(system.corner))
    else:
        system.band[0, 3] = 0.0 if spoil == "zero" else np.nan
    assert system.factor() is None
