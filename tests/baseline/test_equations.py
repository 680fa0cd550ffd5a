"""One sample's step: its motion against scipy's exponential, its derivatives against small changes."""

from dataclasses import replace

import numpy as np
from scipy.linalg import expm
from small_problems import measured, small_chain

from pinn_cli.baseline.equations import flow
from pinn_cli.baseline.state_space import StateSpace
from pinn_cli.record.response import QUANTITIES
from pinn_cli.scheme.problem import Problem


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
    structure = small_chain()
    record = measured(structure).record
    held = StateSpace(Problem(structure, replace(record, intersample="zero_order_hold"))).between
    np.testing.assert_array_equal(held, np.broadcast_to(record.force[:-1], held.shape))
    between = StateSpace(Problem(structure, record)).between
    np.testing.assert_allclose(between[0], record.force[:-1], atol=1e-14)
    np.testing.assert_allclose(between[-1], record.force[1:], atol=1e-12)
    # Seen at every second sample, the spline finds the others.
    sparse = replace(record, **{name: getattr(record, name)[::2] for name in ("time", *QUANTITIES)})
    found = StateSpace(Problem(structure, sparse)).between
    middle = found[len(found) // 2, 5:-5, 0]
    np.testing.assert_allclose(middle, record.force[1::2, 0][5:-5], atol=1e-3 * np.abs(record.force).max())
