"""One sample's step: its matrices against scipy's exponential, its motion against the matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from small_problems import measured, small_chain

from pinn_cli.baseline.discretisation import flow, interpolated_force, propagators
from pinn_cli.record.response import QUANTITIES


def oscillators(ndof: int, fastest: float, seed: int = 0) -> np.ndarray:
    """(3, 2 ndof, 2 ndof), rates of motion of damped oscillators, the fastest of ``fastest`` rad/s."""
    rng = np.random.default_rng(seed)
    rates = np.zeros((3, 2 * ndof, 2 * ndof))
    rates[:, :ndof, ndof:] = np.eye(ndof)
    for one in rates:
        shape = np.linalg.qr(rng.normal(size=(ndof, ndof)))[0]
        squares = np.linspace(0.01, 1.0, ndof) * fastest**2
        one[ndof:, :ndof], one[ndof:, ndof:] = -shape * squares @ shape.T, -0.02 * fastest * np.eye(ndof)
    return rates


@pytest.mark.parametrize("fastest", [1e-3, 1.0, 30.0, 400.0])
def test_propagators_are_the_exponential_and_its_integral(fastest: float) -> None:
    rates, step = oscillators(3, fastest), 0.02
    through, integral = propagators(rates, step, fastest)
    for rate, found, summed in zip(rates, through, integral, strict=True):
        np.testing.assert_allclose(found, expm(rate * step), rtol=1e-11, atol=1e-11 * np.abs(found).max())
        np.testing.assert_allclose(rate @ summed, found - np.eye(6), rtol=1e-10, atol=1e-11 * np.abs(found).max())


def test_the_motion_of_a_linear_chain_is_that_of_its_exponential() -> None:
    structure, step = small_chain("linear"), 0.05
    parameters = structure.parameters_like(np.empty(0))

    def slope(z: np.ndarray, f: np.ndarray) -> np.ndarray:
        return np.stack((z[1], structure.acceleration(z[0], z[1], f, parameters)))

    identity = np.eye(6)
    start = np.stack((identity[:, :3], identity[:, 3:]))
    rates = np.concatenate(tuple(slope(start, np.zeros((6, 3)))), axis=1).T
    errors = []
    for substeps in (1, 2, 4):
        moved = flow(slope, start, np.zeros((2 * substeps + 1, 6, 3)), step)
        errors.append(np.abs(np.concatenate(tuple(moved), axis=1).T - expm(rates * step)).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 4.0, atol=0.2)


def test_the_force_between_the_samples_is_held_or_a_spline() -> None:
    record = measured(small_chain()).record
    held = interpolated_force(replace(record, intersample="zero_order_hold"), 2)
    assert held.shape == (5, len(record.time) - 1, 3)
    np.testing.assert_array_equal(held, np.broadcast_to(record.force[:-1], held.shape))
    between = interpolated_force(record, 1)
    np.testing.assert_allclose(between[0], record.force[:-1], atol=1e-14)
    np.testing.assert_allclose(between[-1], record.force[1:], atol=1e-12)
    # Seen at every second sample, the spline finds the others.
    sparse = replace(record, **{name: getattr(record, name)[::2] for name in ("time", *QUANTITIES)})
    found = interpolated_force(sparse, 1)[1, 5:-5, 0]
    np.testing.assert_allclose(found, record.force[1::2, 0][5:-5], atol=1e-3 * np.abs(record.force).max())
