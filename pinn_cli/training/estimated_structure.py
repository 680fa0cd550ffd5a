"""The model with its estimated parameters in place."""

from __future__ import annotations

from collections.abc import Iterable

from pinn_cli.system.parameters import LINEAR_UNITS
from pinn_cli.system.quantities import CALIBRATION_UNITS
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import ParameterEstimate


def estimated_structure(prescribed: Structure, parameters: Iterable[ParameterEstimate]) -> Structure:
    """The prescribed chain with its estimated parameters in place; those that are not listed stay as prescribed.

    Those of sensors are left out.

    Raises:
        ValueError: A parameter that the chain does not have.
    """
    values = {}
    for estimate in parameters:
        if estimate.kind in CALIBRATION_UNITS:
            continue
        if estimate.parameter.index >= len(prescribed.parameters.get(estimate.kind, ())):
            raise ValueError(f"the chain of {prescribed.ndof} DOFs has no parameter {estimate.name}")
        values[estimate.parameter] = estimate.estimate
    return prescribed.with_values(values)


def sought_laws(structure: Structure, parameters: Iterable[ParameterEstimate]) -> set[int]:
    """The connections, from 0, of whose law a parameter was unknown."""
    of_laws = [p for p in parameters if p.unknown and p.kind in structure.members and p.kind not in LINEAR_UNITS]
    return {int(structure.members[p.kind][p.parameter.index]) for p in of_laws}
