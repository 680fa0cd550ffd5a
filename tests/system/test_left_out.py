"""Forces that a model may have left out, of a motion that is given."""

import numpy as np
import pytest

from pinn_cli.system.left_out import LEFT_OUT, STRIBECK, sliding

STEP = 0.01
TIME = STEP * np.arange(2000)


def test_a_mass_that_holds_moves_as_what_it_lies_on():
    moved = np.sin(3.0 * TIME)
    np.testing.assert_array_equal(sliding(moved, STEP, 1.1), moved)


def test_a_mass_that_slides_is_pulled_no_harder_than_it_holds_and_catches_up():
    """The same velocity in the end, once what it lies on has come to rest."""
    moved = np.where(TIME < 10.0, 3.0 * np.sin(4.0 * TIME), 0.0)
    pulled = sliding(moved, STEP, 1.0)
    assert np.abs(pulled).max() == pytest.approx(1.0)
    assert pulled.sum() * STEP == pytest.approx(moved.sum() * STEP, abs=1e-12)
    assert pulled[-1] == 0.0


def test_friction_that_differs_where_it_turns_round_is_nothing_in_motion():
    (force,) = (lacking.force for lacking in LEFT_OUT if lacking.kind == STRIBECK)
    e, de = np.sin(3.0 * TIME), 3.0 * np.cos(3.0 * TIME)
    found = force(e, de, 0.1 * np.sqrt(np.mean(e**2)))
    assert np.abs(found[np.abs(de) > 1.0]).max() < 1e-9
    slow = (np.abs(de) > 0.15) & (np.abs(de) < 0.2)
    assert np.all(found[slow] * np.sign(de[slow]) > 0.3)
