"""From ``system.damping``, as a user writes it, to a structure that is damped as a whole."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from scipy.sparse import csr_matrix

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import entries, is_finite_number, is_usable_number
from pinn_cli.system.connection_groups import ConnectionGroup
from pinn_cli.system.damping import MassProportional, ModalRatios, StiffnessProportional, StructuralDamping
from pinn_cli.system.incidence import Incidence
from pinn_cli.system.parameters import MASS
from pinn_cli.system.structure import Structure

SETTING = "system.damping"
_ALLOWED = "{ratio: 0.02}, {ratio: [0.02, 0.015]} (by mode), or {rayleigh: [a_0, a_1]} (1/s, s); null is unknown"


def damped(structure: Structure, damping: Any) -> Structure:
    """A structure with damping of the whole beside the dampers of its connections.

    Args:
        structure: Without it.
        damping: ``{ratio: x}`` of every mode, ``{ratio: [x, y]}`` mode by mode, where the last one is that of all modes
            that follow, or ``{rayleigh: [a_0, a_1]}``; an entry that is null is NaN in the structure. None: none.

    Raises:
        InputError: Naming ``system.damping``.
    """
    if damping is None:
        return structure
    if not isinstance(damping, Mapping) or len(damping) != 1 or next(iter(damping)) not in ("ratio", "rayleigh"):
        raise InputError(SETTING, damping, _ALLOWED)
    ((form, given),) = damping.items()
    if form == "ratio":
        return _with(structure, ModalRatios(), _ratios(given, structure))
    values = entries(given)
    if len(values) != 2 or not all(x is None or (is_usable_number(x) and x >= 0) for x in values):
        raise InputError(f"{SETTING}.rayleigh", given, "two numbers >= 0, [a_0, a_1] in 1/s and s, or null")
    of_mass, of_stiffness = (math.nan if x is None else float(x) for x in values)
    return _with(_with(structure, MassProportional(), [of_mass]), StiffnessProportional(), [of_stiffness])


def _ratios(given: Any, structure: Structure) -> list[float]:
    values = [given] if given is None or is_finite_number(given) else entries(given)
    modes = structure.coordinates - structure.shapes.residual
    if not 1 <= len(values) <= modes or not all(x is None or (is_finite_number(x) and 0 <= x < 1) for x in values):
        allowed = f"a number from 0 to below 1, or a list of at most {modes}, one for each mode"
        raise InputError(f"{SETTING}.ratio", given, allowed, "0.02 is two per cent; null is unknown")
    return [math.nan if x is None else float(x) for x in values]


def _with(structure: Structure, law: StructuralDamping, values: list[float]) -> Structure:
    """The structure with dampers of a law behind its connections; of springs of one where a stiffness is unknown."""
    before = structure.incidence.matrix
    mass = np.nan_to_num(structure.parameters_like(np.empty(0))[MASS], nan=1.0)
    rows = law.rows(mass, before, np.ones(before.shape[0]))
    group = ConnectionGroup(law, Incidence(csr_matrix((0, before.shape[1]))), tuple(range(len(values)))).of_rows(rows)
    parameters = {**structure.parameters, law.kind: torch.tensor(values, dtype=torch.float64)}
    return replace(structure, parameters=parameters, groups=(*structure.groups, group)).present()
