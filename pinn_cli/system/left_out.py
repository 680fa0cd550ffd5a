"""A structure with terms beside its connections that a model may have left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from pinn_cli.system.connection.friction import Friction
from pinn_cli.system.connection.polynomial import Polynomial
from pinn_cli.system.connection.power_damping import PowerDamping
from pinn_cli.system.connection_groups import ConnectionGroup
from pinn_cli.system.incidence import Incidence
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.structure import Structure

# Speed over which such a friction changes its sign, in rms speeds of its connection.
CREEP = 0.05
# Kind of such a term to its unit and to what people call it.
TERMS = {
    "k_3": ("N/m^3", "cubic term"),
    "mu": ("N (s/m)^2", "quadratic damping"),
    "F_c": ("N", "friction"),
}


def with_left_out(
    structure: Structure, connections: Sequence[int], speed: np.ndarray
) -> tuple[Structure, list[Parameter]]:
    """The structure with a cubic spring, a quadratic damper and friction beside some connections, all of them zero.

    Args:
        structure: The model.
        connections: Which, C of them, counted from 0; none of a part of a finite-element model.
        speed: (C,), rms of the rate of their elongations, m/s.

    Returns:
        It, and the terms: C cubic ones, C quadratic ones, C frictions.
    """
    rows = [Incidence(structure.incidence.matrix[c]) for c in connections]
    laws = [(Polynomial([3]), rows), (PowerDamping(2.0), rows)]
    laws += [(Friction(CREEP * v), [row]) for row, v in zip(rows, speed.tolist(), strict=True)]
    groups = tuple(ConnectionGroup(law, Incidence.stacked(own)) for law, own in laws)
    # Parts of a finite-element model come last.
    before = sum(group.parts is None for group in structure.groups)
    parameters, terms = dict(structure.parameters), []
    for kind in ("c", "k", *TERMS):
        own = parameters.get(kind, parameters["k"][:0])
        parameters[kind] = torch.cat((own, own.new_zeros(len(rows) * (1 if kind in TERMS else len(TERMS)))))
        if kind in TERMS:
            unit, title = TERMS[kind]
            terms += [
                Parameter(kind, len(own) + i, 0.0, unit=unit, title=title, label=structure.labels.connection(c))
                for i, c in enumerate(connections)
            ]
    every = (*structure.groups[:before], *groups, *structure.groups[before:])
    return replace(structure, parameters=parameters, groups=every), terms
