"""A structure goes into a file and comes back the same, whatever it was made of."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from beams import beam, beam_part, deflection
from scipy.io import mmwrite
from structures import braced, hysteretic, modal, shuffled

from pinn_cli.model.file import difference, structure_content, structure_of
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.system.connection.friction import Friction
from pinn_cli.system.connection.polynomial import Polynomial
from pinn_cli.system.finite_elements import build_finite_elements
from pinn_cli.system.incidence import Pairs
from pinn_cli.system.parameters import Labels
from pinn_cli.system.structure import Structure


def again(structure: Structure) -> Structure:
    words, arrays = structure_content(structure)
    return structure_of(json.loads(json.dumps(words)), arrays)


def polynomial() -> Structure:
    return build_chain(2, Polynomial(), m=1.0, c=0.1, k=10.0, k_2=1.0, k_5=[3.0, 4.0])


def sliding() -> Structure:
    return build_chain(2, Friction(0.01), m=1.0, c=0.1, k=10.0, F_c=[2.0, 1.0])


def named() -> Structure:
    labels = Labels(tuple("abc"), ("one", "two", "three", "brace", "other", "damper"))
    pairs = Pairs.of(["roof"], [{0: -1.0, 2: 1.0}], 3)
    return replace(braced(), labels=labels, influence=np.array([1.0, 0.5, 1.0]), pairs=pairs)


@pytest.mark.parametrize("make", [braced, shuffled, hysteretic, modal, polynomial, sliding, named])
def test_the_same_forces_and_names(make):
    structure = make()
    copy = again(structure)
    rng = np.random.default_rng(0)
    u, v, a = rng.standard_normal((3, 5, structure.coordinates))
    np.testing.assert_array_equal(
        copy.connection_force(copy.elongation(u), copy.elongation(v)),
        structure.connection_force(structure.elongation(u), structure.elongation(v)),
    )
    if not len(structure.memory):
        np.testing.assert_array_equal(copy.external_force(u, v, a), structure.external_force(u, v, a))
    assert copy.labels == structure.labels
    assert [p.name for p in copy.every_parameter()] == [p.name for p in structure.every_parameter()]
    np.testing.assert_array_equal(copy.with_ground, structure.with_ground)
    assert copy.drift_names == structure.drift_names
    np.testing.assert_array_equal(copy.drifts.toarray(), structure.drifts.toarray())
    if structure.is_modal:
        np.testing.assert_array_equal(copy.shapes.matrix, structure.shapes.matrix)
    assert difference(copy, structure) == ""


def test_parts_of_a_finite_element_model(tmp_path):
    M, K = beam(12)
    np.savez(tmp_path / "beam.npz", M=M.toarray(), K=K.toarray())
    mmwrite(str(tmp_path / "base.mtx"), beam_part(12, range(5)))
    structure = build_finite_elements(
        path="beam.npz", base=tmp_path, factors={"base": "base.mtx"}, dofs={"tip": deflection(12)}, modes=4,
        damping_ratio=0.01, loaded=["tip"],
    )  # fmt: skip
    structure = structure.with_parameters(factor=torch.tensor([0.9], dtype=torch.float64))
    copy = again(structure)
    u = np.random.default_rng(0).standard_normal((3, structure.coordinates))
    np.testing.assert_array_equal(copy.restoring_force(u, u), structure.restoring_force(u, u))
    assert copy.parameter("factor", 0).name == "factor_base"
    # A run reduces it anew at the factors that it finds; whoever has its matrices has the same structure.
    found = again(structure.reduced_at())
    assert not np.allclose(found.shapes.matrix, structure.shapes.matrix, rtol=1e-6)
    assert difference(structure.with_parameters(factor=torch.ones(1, dtype=torch.float64)), found) == ""
    assert difference(copy, found) == "other connections"


@pytest.mark.parametrize(
    ("other", "word"),
    [
        (lambda: build_chain(3, Linear(), m=1.0, c=0.1, k=10.0), "3 DOFs, not 2"),
        (lambda: build_chain(2, Linear(), m=1.0, c=0.1, k=10.0), "linear connections"),
        (lambda: build_chain(2, Friction(0.02), m=1.0, c=0.1, k=10.0, F_c=1.0), "other settings"),
    ],
)
def test_what_tells_two_structures_apart(other, word):
    assert word in difference(other(), sliding())


def test_values_tell_no_structures_apart():
    assert difference(sliding().with_values({sliding().parameter("k", 1): 99.0}), sliding()) == ""
