"""A structure as plain words and arrays, and back: a run's directory holds all of it, whatever files it came from."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from scipy.sparse import csr_matrix

from pinn_cli.system.building import law_called
from pinn_cli.system.connection.base import Nonlinearity
from pinn_cli.system.connection_groups import ConnectionGroup
from pinn_cli.system.damping import MassProportional, ModalRatios, StiffnessProportional, StructuralDamping
from pinn_cli.system.incidence import Incidence, Pairs
from pinn_cli.system.parameters import Labels
from pinn_cli.system.shapes import Shapes
from pinn_cli.system.structure import Structure
from pinn_cli.system.substructures import Substructure

# What the law of a finite-element model's parts is called here; no connection can be given it.
PART = "part"
# Likewise damping of the whole.
DAMPING = {law.kind: law for law in (ModalRatios, MassProportional, StiffnessProportional)}


def structure_content(structure: Structure) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Words and arrays that :func:`structure_of` makes the same structure of."""
    words: dict[str, Any] = {
        "dofs": list(structure.labels.dofs),
        "connections": list(structure.labels.connections),
        "modes": list(structure.labels.modes),
        "supports": list(structure.labels.supports),
        "groups": [_group_words(group) for group in structure.groups],
        "kinds": list(structure.parameters),
    }
    shapes = structure.shapes if structure.is_modal else None
    if shapes is not None:
        words["residual"], words["below"] = shapes.residual, shapes.below
    if structure.pairs is not None:
        words["pairs"] = list(structure.pairs.names)
    matrices = {
        **{f"value_{kind}": values for kind, values in structure.parameters_like(np.empty(0)).items()},
        **{f"group_{number}": group.incidence.matrix for number, group in enumerate(structure.groups)},
        "influence": None if structure.influence is None else np.asarray(structure.influence, dtype=float),
        "shapes": None if shapes is None else shapes.matrix,
        "shapes_exact_at": None if shapes is None else shapes.exact_at,
        "shapes_with_ground": None if shapes is None else shapes.with_ground,
        "shapes_stretch": None if shapes is None else shapes.stretch,
        "by_supports": structure.by_supports,
        "pairs": None if structure.pairs is None else structure.pairs.weights,
    }
    arrays: dict[str, np.ndarray] = {}
    for name, matrix in matrices.items():
        if isinstance(matrix, csr_matrix):
            parts = {part: getattr(matrix, part) for part in ("data", "indices", "indptr")}
            arrays |= {f"{name}_{part}": values for part, values in (parts | {"shape": np.array(matrix.shape)}).items()}
        elif matrix is not None:
            arrays[name] = matrix
    return words, arrays


def structure_of(words: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> Structure:
    """The structure of what :func:`structure_content` gave.

    Raises:
        KeyError, ValueError, TypeError, InputError: It is no such content.
    """
    groups = tuple(
        ConnectionGroup(_law(own), Incidence(_matrix(f"group_{number}", arrays)), _parts(own))
        for number, own in enumerate(words["groups"])
    )
    labels = Labels(*(tuple(map(str, words.get(name, ()))) for name in ("dofs", "connections", "modes", "supports")))
    parameters = {str(k): torch.tensor(np.asarray(arrays[f"value_{k}"], dtype=float)) for k in words["kinds"]}
    stretch, by_supports, weights = (
        _matrix(name, arrays) if f"{name}_shape" in arrays else None
        for name in ("shapes_stretch", "by_supports", "pairs")
    )
    modes = None
    if "shapes" in arrays:
        own = arrays["shapes"], arrays.get("shapes_with_ground"), stretch, int(words["residual"])
        modes = Shapes(*own, below=int(words.get("below", 0)), exact_at=arrays.get("shapes_exact_at"))
    pairs = None if weights is None else Pairs(tuple(words["pairs"]), weights)
    return Structure(parameters, groups, labels, arrays.get("influence"), modes, pairs, by_supports=by_supports)


def difference(structure: Structure, other: Structure) -> str:
    """What tells two structures apart beside the values of their parameters; "" where nothing does.

    Masses count as values: whoever simulates a change may change them.
    """
    if other_dofs(structure, other):
        return other_dofs(structure, other)
    if other.shapes.exact_at is not None:
        structure = structure.reduced_at(other.shapes.exact_at)
    if structure.nonlinearity_name != other.nonlinearity_name or [g.kinds for g in structure.groups] != [
        g.kinds for g in other.groups
    ]:
        return f"{structure.nonlinearity_name} connections, not {other.nonlinearity_name}"
    if [_group_words(group) for group in structure.groups] != [_group_words(group) for group in other.groups]:
        return f"{structure.nonlinearity_name} connections of other settings"
    if structure.labels != other.labels:
        return "other names of connections"
    mine, theirs = (_stretch(one) for one in (structure, other))
    if mine.shape != theirs.shape or abs(mine - theirs).max() > 1e-9 * abs(theirs).max():
        return "other connections"
    return ""


def _stretch(structure: Structure) -> csr_matrix:
    """(C', n + S), of the connections that are no damping of the whole; that stands behind them."""
    return structure.stretch.matrix[: sum(g.incidence.shape[0] for g in structure.groups if not g.damps_whole)]


def other_dofs(structure: Structure, other: Structure) -> str:
    """What tells the DOFs of two structures apart; "" where nothing does."""
    if structure.ndof != other.ndof:
        return f"{structure.ndof} DOFs, not {other.ndof}"
    if structure.labels.dofs != other.labels.dofs:
        return f"DOFs {', '.join(structure.labels.dofs or ('by number',))}"
    return ""


def _group_words(group: ConnectionGroup) -> dict[str, Any]:
    law = group.nonlinearity
    if isinstance(law, Substructure | StructuralDamping):
        name = PART if isinstance(law, Substructure) else law.kind
        return {"law": name, "settings": {}, "parts": list(group.parts or ())}
    settings = {name: getattr(law, name) for name in inspect.signature(type(law)).parameters if hasattr(law, name)}
    plain = {name: list(value) if isinstance(value, tuple) else value for name, value in settings.items()}
    return {"law": law.name, "settings": plain, "parts": None if group.parts is None else list(group.parts)}


def _law(words: Mapping[str, Any]) -> Nonlinearity:
    if words["law"] in DAMPING:
        return DAMPING[words["law"]]()
    return Substructure() if words["law"] == PART else law_called(words["law"], words["settings"], "model")


def _parts(words: Mapping[str, Any]) -> tuple[int, ...] | None:
    return None if words["parts"] is None else tuple(int(part) for part in words["parts"])


def _matrix(name: str, arrays: Mapping[str, np.ndarray]) -> csr_matrix:
    data, indices, indptr, shape = (arrays[f"{name}_{part}"] for part in ("data", "indices", "indptr", "shape"))
    matrix = csr_matrix((data, indices, indptr), shape=tuple(int(x) for x in shape))
    matrix.check_format(full_check=True)  # indices beyond the shape would be read beyond the memory
    return matrix
