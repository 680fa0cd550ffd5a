"""Poles of a record, by order and scale."""

from __future__ import annotations

import numpy as np
import pytest
from vibrating_records import BUILDING, RIG, of_building, of_hammer

from pinn_cli.record.identification.subspace import assurance, stabilisation


@pytest.mark.parametrize(("make", "structure"), [(of_building, BUILDING), (of_hammer, RIG)])
def test_stable_poles_are_those_of_the_structure(make, structure):
    record = make(0)
    clusters = stabilisation(record.outputs, record.inputs, 1.0 / record.rate).clusters()
    found = np.array([[f, damping] for f, damping, _ in clusters])
    for f, shape in zip(structure.frequency, structure.shapes.T, strict=True):
        nearest = int(np.argmin(np.abs(found[:, 0] - f)))
        assert found[nearest, 0] == pytest.approx(f, rel=5e-3)
        assert assurance(clusters[nearest][2][None], shape[None])[0, 0] > 0.95


def test_a_channel_that_does_not_move_has_no_poles():
    still = np.zeros((1000, 2))
    assert stabilisation(still, still[:, :0], 0.01).clusters() == []


def test_assurance():
    one, other = np.array([[1.0, 2.0], [1.0, 0.0]]), np.array([[-2.0, -4.0], [0.0, 1j]])
    np.testing.assert_allclose(assurance(one, other), [[1.0, 0.8], [0.2, 0.0]])
