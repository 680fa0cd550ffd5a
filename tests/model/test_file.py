"""The file of a model, and a structure in it: what goes in comes out, and what is none is refused in one line."""

import json
import pickle
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from beams import beam, beam_part, deflection
from calls import refusal
from scipy.io import mmwrite
from structures import braced, hysteretic, modal, shuffled

from pinn_cli.model.file import NAME, difference, read_model, structure_content, structure_of, write_model
from pinn_cli.model.knowledge import MOST_KEPT, DiscrepancyEvidence, EndState, Levels, Misfit, Model, ParameterKnowledge
from pinn_cli.system.basis import bending_at, reduced_at, shares_basis
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.system.connection.friction import Friction
from pinn_cli.system.connection.polynomial import Polynomial
from pinn_cli.system.connection.spline import Spline
from pinn_cli.system.finite_elements import build_finite_elements
from pinn_cli.system.incidence import Pairs
from pinn_cli.system.parameters import Labels
from pinn_cli.system.structure import Structure


def model() -> Model:
    structure = braced()
    parameters = tuple(
        replace(structure.parameter("k", i), prescribed=v, prior_std=s, unknown=i > 0, positive=True)
        for i, (v, s) in enumerate([(15.0, 150.0), (14.0, 1.0)])
    )
    known = ParameterKnowledge(
        np.array([15.0, 14.0]), np.array([[0.04, 0.01], [0.01, 0.09]]), np.array([1.0, 0.0]), np.array([4.0, 0.0]),
        np.array([150.0, 1.0]),
    )  # fmt: skip
    told = DiscrepancyEvidence(1e-3, True, np.array([-4.0, -3.0]), np.array([0.0, -1.5]))
    levels = Levels({"acceleration": np.array([0.1, np.nan, 0.2])}, 0.3, 0.01, 5.0, 7.5, told)
    end = EndState(2.0, np.arange(6.0), np.eye(6), np.ones((6, 2)))
    misfit = Misfit.of(0.01, np.arange(12.0).reshape(4, 3), 5.0, 0.25, 0.75)
    return Model(structure, parameters, known, levels, end, "questionable", "why", np.ones((4, 2)), misfit=misfit)


def run(directory: Path, content: Model | None = None, finished: bool = True) -> Path:
    directory.mkdir()
    (directory / ".hydra").mkdir()
    if content is not None:
        write_model(content, directory)
    if finished:
        (directory / "run.json").write_text(json.dumps({"configuration": "abc"}))
    return directory


def test_what_goes_in_comes_out(tmp_path):
    there = model()
    back = read_model("run", run(tmp_path / "run", there).parent)
    assert back.directory == tmp_path / "run"
    assert (back.verdict, back.reason) == ("questionable", "why")
    assert [p.name for p in back.parameters] == ["k_1", "k_2"]
    for p, q in zip(back.parameters, there.parameters, strict=True):
        assert (p.prescribed, p.prior_std, p.unknown, p.positive) == (q.prescribed, q.prior_std, q.unknown, q.positive)
    np.testing.assert_array_equal(back.known.covariance, there.known.covariance)
    np.testing.assert_allclose(back.known.hidden, [0.25, 0.0], rtol=1e-5)
    np.testing.assert_array_equal(back.levels.sensors["acceleration"], [0.1, np.nan, 0.2])
    assert (back.levels.discrepancy, back.levels.step, back.levels.force, back.levels.features) == (0.3, 0.01, 5.0, 7.5)
    assert (back.levels.windows.start, back.levels.windows.common) == (1e-3, True)
    np.testing.assert_array_equal(back.levels.windows.at(np.array([-5.0, -3.5, 0.0])), [0.0, -0.75, -1.5])
    np.testing.assert_array_equal(back.end.mean, np.arange(6.0))
    np.testing.assert_array_equal(back.draws, np.ones((4, 2)))
    np.testing.assert_array_equal(back.misfit.history, np.arange(12.0).reshape(4, 3))
    assert (back.misfit.step, back.misfit.acting, back.misfit.rest, back.misfit.at_motion) == (0.01, 5.0, 0.25, 0.75)


def test_of_a_long_history_the_end_is_kept():
    long = np.broadcast_to(np.arange(MOST_KEPT, dtype=float)[:, None], (MOST_KEPT, 4))
    kept = Misfit.of(0.01, long, 1.0, 0.0).history
    assert kept.shape == (MOST_KEPT // 4, 4)
    assert kept[-1, 0] == MOST_KEPT - 1


def test_what_is_no_model_is_refused(tmp_path):
    run(tmp_path / "half", model(), finished=False)
    run(tmp_path / "old")
    run(tmp_path / "failed", replace(model(), verdict="failed", reason="a sensor has the wrong sign"))
    for name in ("empty", "sweep"):
        (tmp_path / name).mkdir()
    (tmp_path / "sweep" / "multirun.yaml").write_text("")
    for given, told in (
        ("nowhere", "no such directory"), (3, "directory of a finished run"), ("empty", "has no run.json"),
        ("half", "has not finished"), ("old", "has no model.npz"), ("sweep", "one of its jobs"),
        ("failed", "wrong sign"),
    ):  # fmt: skip
        assert re.match(f"model=.*{told}", refusal(read_model, given, tmp_path))


def damaged(file: Path, **changes: object) -> None:
    with np.load(file) as content:
        arrays = dict(content)
    np.savez(file, **{name: value for name, value in (arrays | changes).items() if value is not None})


@pytest.mark.parametrize(
    "changes",
    [
        {"content": None},
        {"content": np.frombuffer(b"[]", dtype=np.uint8)},
        {"parameters_mean": np.zeros(3)},
        {"parameters_covariance": np.zeros((3, 3))},
        {"structure_value_k": None},
        {"structure_group_0_indices": np.array([7, 8, 9])},
        {"draws": np.array([object()], dtype=object)},
        {"misfit_history": np.zeros((4, 2))},
        {"misfit_history": np.full((4, 3), np.nan)},
    ],
)
def test_a_damaged_file_is_refused(tmp_path, changes):
    there = run(tmp_path / "run", model())
    damaged(there / NAME, **changes)
    assert "cannot be read" in refusal(read_model, "run", tmp_path)


def test_nothing_in_it_is_executed(tmp_path):
    there = run(tmp_path / "run", model())
    (there / NAME).write_bytes(pickle.dumps(print))
    assert "cannot be read" in refusal(read_model, "run", tmp_path)
    (there / NAME).write_bytes(b"PK\x03\x04")
    assert "cannot be read" in refusal(read_model, "run", tmp_path)


def again(structure: Structure) -> Structure:
    words, arrays = structure_content(structure)
    return structure_of(json.loads(json.dumps(words)), arrays)


def polynomial() -> Structure:
    return build_chain(2, Polynomial(), m=1.0, c=0.1, k=10.0, k_2=1.0, k_5=[3.0, 4.0])


def sliding() -> Structure:
    return build_chain(2, Friction(0.01), m=1.0, c=0.1, k=10.0, F_c=[2.0, 1.0])


def curved() -> Structure:
    """With knots that an estimate has moved."""
    law = Spline(elongation=(-0.5, 1.0), speed=2.0, terms=5)
    terms = {kind: np.linspace(1.0, -1.0, 2) / (1 + i) for i, kind in enumerate(law.parameters)}
    structure = build_chain(2, law, m=1.0, c=0.1, k=10.0, **{kind: x.tolist() for kind, x in terms.items()})
    moved = bending_at(structure, structure.parameters_like(np.empty(0)))
    assert not shares_basis(moved, structure)
    return moved


def named() -> Structure:
    labels = Labels(tuple("abc"), ("one", "two", "three", "brace", "other", "damper"))
    pairs = Pairs.of(["roof"], [{0: -1.0, 2: 1.0}], 3)
    return replace(braced(), labels=labels, influence=np.array([1.0, 0.5, 1.0]), pairs=pairs)


@pytest.mark.parametrize("make", [braced, shuffled, hysteretic, modal, polynomial, sliding, curved, named])
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
    found = again(reduced_at(structure))
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


def test_what_nobody_has_said_an_estimate_may_choose():
    found = curved()
    law = Spline((-0.5, 1.0), 2.0, terms=5)
    said = build_chain(2, law, m=1.0, c=0.1, k=10.0, **dict.fromkeys(law.parameters, 0.0))
    assert difference(said, found) == ""
    assert "other settings" in difference(found, said)
