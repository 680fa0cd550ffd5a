"""Natural modes against closed forms, scipy's eigenvalues and difference quotients."""

import numpy as np
import pytest
import torch
from scipy.linalg import eigh
from structures import braced, hysteretic, shuffled

from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Friction, Linear, PowerDamping, VanDerPol
from pinn_cli.system.modes import NaturalModes, at_rest


def uniform(ndof: int = 5, c: float = 0.0):
    return build_chain(ndof, Linear(), m=2.0, c=c, k=800.0)


def test_a_uniform_chain():
    modes = NaturalModes.of(uniform(c=4.0))
    order = np.arange(1, 6)
    omega = 2.0 * np.sqrt(400.0) * np.sin((2 * order - 1) * np.pi / 22.0)
    np.testing.assert_allclose(modes.frequencies, omega / (2.0 * np.pi), rtol=1e-9)
    np.testing.assert_allclose(modes.damping_ratios, 0.5 * 4.0 / 800.0 * omega, rtol=1e-9)
    shapes = np.sin(np.outer(order, (2 * order - 1) * np.pi / 11.0))
    at = np.abs(shapes).argmax(axis=0)
    np.testing.assert_allclose(np.abs(modes.shapes), np.abs(shapes / shapes[at, np.arange(5)]), atol=1e-9)
    assert np.abs(modes.shapes).max(axis=0) == pytest.approx(1.0)


def test_a_damped_oscillator_that_creeps_back():
    modes = NaturalModes.of(build_chain(1, Linear(), m=1.0, c=5.0, k=4.0))
    assert modes.frequencies == pytest.approx(2.0 / (2.0 * np.pi))
    assert modes.damping_ratios == pytest.approx(1.25)
    assert np.isnan(modes.poles).all()


def test_damping_that_is_not_proportional_takes_the_poles():
    structure = build_chain(2, Linear(), m=1.0, c=[0.0, 3.0], k=[100.0, 40.0])
    modes = NaturalModes.of(structure)
    matrix = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-140, 40, -3, 3], [40, -40, 3, -3]])
    poles = np.linalg.eigvals(matrix)
    poles = poles[poles.imag > 0]
    poles = poles[np.argsort(np.abs(poles))]
    np.testing.assert_allclose(2.0 * np.pi * modes.frequencies, np.abs(poles), rtol=1e-10)
    np.testing.assert_allclose(modes.damping_ratios, -poles.real / np.abs(poles), rtol=1e-9)


def test_what_a_law_is_at_rest_counts():
    van_der_pol = build_chain(2, VanDerPol(), m=1.0, c=1.0, k=10.0, mu=3.0)
    np.testing.assert_allclose(at_rest(van_der_pol)[1], -2.0)
    assert (NaturalModes.of(van_der_pol).damping_ratios < 0).all()
    np.testing.assert_allclose(at_rest(build_chain(2, Friction(0.1), m=1.0, c=1.0, k=10.0, F_c=3.0))[1], 31.0)
    np.testing.assert_allclose(at_rest(build_chain(2, PowerDamping(1.0), m=1.0, c=1.0, k=10.0, mu=3.0))[1], 4.0)
    structure = hysteretic()
    k, _ = at_rest(structure)
    own, hidden = (structure.parameters[kind].numpy() for kind in ("k", "A"))
    np.testing.assert_allclose(k, [own[0], *(own[1:] + hidden)])
    B, root = structure.incidence.matrix.toarray(), np.diag(structure.parameters["m"].numpy())
    undamped = structure.with_parameters(c=torch.zeros(3, dtype=torch.float64))
    exact = eigh(B.T @ np.diag(k) @ B, root, eigvals_only=True)
    np.testing.assert_allclose(NaturalModes.of(undamped).squares, exact, rtol=1e-9)


def test_a_body_that_nothing_holds():
    modes = NaturalModes.of(build_chain(2, Linear(), m=1.0, c=[0.0, 0.1], k=[0.0, 10.0]))
    assert modes.frequencies == pytest.approx([0.0, np.sqrt(20.0) / (2.0 * np.pi)])
    assert np.isnan(modes.damping_ratios[0])
    np.testing.assert_allclose(modes.shapes[:, 0], 1.0)
    held = build_chain(2, Linear(), m=1.0, c=0.1, k=10.0)
    pushed = NaturalModes.of(held.with_parameters(k=torch.tensor([-5.0, 10.0], dtype=torch.float64)))
    assert np.isnan(pushed.frequencies[0])
    assert np.isfinite(pushed.frequencies[1])


@pytest.mark.parametrize(("kind", "value"), [("k", np.nan), ("m", 0.0)])
def test_no_modes_without_numbers(kind, value):
    structure = uniform()
    values = structure.parameters[kind].clone()
    values[1] = value
    assert NaturalModes.of(structure.with_parameters(**{kind: values})) is None


@pytest.mark.parametrize(
    "structure",
    [braced(), hysteretic(), shuffled(), build_chain(1, Linear(), m=1.0, c=5.0, k=4.0), uniform(3, 1.0)],
    ids=["braced", "hysteretic", "shuffled", "creeping", "chain"],
)
def test_slopes_are_difference_quotients(structure):
    parameters = list(structure.every_parameter())
    slopes = NaturalModes.of(structure).slopes(parameters)
    for column, p in enumerate(parameters):
        step = 1e-4 * abs(p.prescribed)  # a smaller one's quotient has the machine's rounding in it
        above, below = (NaturalModes.of(structure.with_values({p: p.prescribed + x})) for x in (step, -step))
        for slope, name in zip(slopes, ("squares", "damping_ratios"), strict=True):
            quotient = (getattr(above, name) - getattr(below, name)) / (2.0 * step)
            np.testing.assert_allclose(slope[:, column], quotient, rtol=1e-4, atol=1e-7, err_msg=p.name)


def test_modes_find_their_partners():

    one, other = NaturalModes.of(uniform()), NaturalModes.of(uniform(c=1.0))
    np.testing.assert_allclose(one.assurance(other), np.eye(5), atol=1e-12)
    swapped = NaturalModes(other.structure, *(getattr(other, name)[::-1] for name in ("squares", "damping_ratios",
                           "poles")), other.vectors[:, ::-1])  # fmt: skip
    np.testing.assert_array_equal(one.partners(swapped), [4, 3, 2, 1, 0])
