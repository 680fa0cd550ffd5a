"""In what a structure is written down: coordinates of a finite-element model, functions of curves that nobody knows.

An estimator moves both to where its solution asks for, and carries the structure over.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch

from pinn_cli.system.parameters import FACTOR, Parameter
from pinn_cli.system.structure import Structure


def shares_basis(structure: Structure, other: Structure) -> bool:
    """Whether another structure of the same model has the same coordinates, and its curves the same functions."""
    laws = zip(*([group.nonlinearity for group in side.groups] for side in (structure, other)), strict=True)
    same_functions = all(mine is theirs for mine, theirs in laws if mine.curves)
    return structure.mode_shapes is other.mode_shapes and same_functions


def in_basis_of(structure: Structure, other: Structure) -> Structure:
    """The same model, with these parameters, in the coordinates and with the functions that another of it has."""
    if structure.mode_shapes is not other.mode_shapes:
        structure = _in_coordinates_of(structure, other)
    return with_functions_of(structure, other)


def with_functions_of(structure: Structure, other: Structure) -> Structure:
    """The same model, with these parameters, with curves of the functions that those of another of it have."""
    others = [group.nonlinearity for group in other.groups]  # with damping of the whole behind, or without
    laws = (group.nonlinearity for group in structure.groups)
    return structure.with_laws([others[i] if law.curves else law for i, law in enumerate(laws)])


def bending_at(structure: Structure, parameters: Mapping[str, np.ndarray]) -> Structure:
    """The same with curves that nobody has a law for in functions that bend where they do at these parameters."""
    groups = zip(structure.groups, structure.parts, strict=True)
    return structure.with_laws([group.nonlinearity.bending_at(part.of_group(parameters)) for group, part in groups])


def term_size(structure: Structure, parameter: Parameter) -> float:
    """How large a term of a curve that nobody has a law for may be, over that of the smoothest function."""
    law = structure.laws[structure.members[parameter.kind][parameter.index]]
    return law.starts(1.0, 1.0)[parameter.kind][-1]


def reduced_at(structure: Structure, factors: np.ndarray | None = None) -> Structure:
    """The same in coordinates that are exact where parts of a finite-element model have some factors (P,).

    None are its own. It is as it was where the model is not at hand, or is no structure there.
    """
    if structure.reduction is None:
        return structure
    at = structure.parameters_like(np.empty(0))[FACTOR] if factors is None else factors
    if not (at > 0).all():
        return structure
    other = structure.reduction.at(at)
    fits = [group.incidence.shape[0] for group in (structure.groups[0], other.groups[0])]
    return _in_coordinates_of(structure, other) if fits[0] == fits[1] else structure


def is_exact_at(structure: Structure, factors: np.ndarray, tolerance: float) -> bool:
    """Whether its coordinates are exact within a relative tolerance of factors (P,), or there are no others."""
    if structure.reduction is None:
        return True
    at = structure.shapes.exact_at
    return at is not None and bool(np.all(np.abs(factors / at - 1.0) <= tolerance))


def _in_coordinates_of(structure: Structure, other: Structure) -> Structure:
    """Of finite elements, in the coordinates of another reduction of it, with laws of the same functions as before.

    What springs and dampers of the coordinates were beside those that the model gives them, they are again.
    """
    values, springs = dict(structure.parameters), structure.groups[0].incidence.shape[0]
    for kind in ("c", "k"):
        given, made = (
            now if side.reduction is None else side.reduction.structure.parameters[kind][:springs]
            for side, now in ((structure, values[kind][:springs]), (other, other.parameters[kind][:springs]))
        )
        now = values[kind][:springs]
        kept = torch.where(given.isfinite() & (given != 0), made * now / given, now)
        values[kind] = torch.cat([kept, values[kind][springs:]])
    connections, others = ([g for g in side.groups if not g.damps_whole] for side in (structure, other))
    pairs, damping = zip(connections, others, strict=True), (g for g in structure.groups if g.damps_whole)
    return replace(
        structure,
        parameters=values,
        groups=(*(replace(new, nonlinearity=mine.nonlinearity) for mine, new in pairs), *damping),
        labels=replace(structure.labels, connections=other.labels.connections),
        influence=other.influence,
        mode_shapes=other.mode_shapes,
        reduction=other.reduction,
    ).present()
