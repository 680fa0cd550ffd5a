"""Internal forces of the connections over time, estimated and true."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pinn_cli.record.record import Truth
    from pinn_cli.system.structure import Structure
    from pinn_cli.training.estimate import Estimate


@dataclass(frozen=True, eq=False)
class ConnectionForces:
    """Of C connections, `Structure.added`.

    Attributes:
        names: Of the connections; their numbers from 1 where they have none.
        memory: (h,), those that have memory.
        elongation: (N, C), m.
        estimate: (N, C), N.
        std: (N, C), N.
        true_elongation, true: (N, C); NaN where unknown.
    """

    names: tuple[str, ...]
    memory: np.ndarray
    elongation: np.ndarray
    estimate: np.ndarray
    std: np.ndarray
    true_elongation: np.ndarray
    true: np.ndarray

    @classmethod
    def of(cls, structure: Structure, estimate: Estimate, truth: Truth) -> ConnectionForces | None:
        """Of an estimate whose training tells them; None of another."""
        found = estimate.connections
        if found is None:
            return None
        names = tuple(structure.labels.connection(i) for i in structure.added)
        memory = np.searchsorted(structure.added, structure.memory)
        true_elongation, true = _true(structure, truth, found.force.shape)
        return cls(names, memory, found.elongation, found.force, found.force_std, true_elongation, true)


def _true(structure: Structure, truth: Truth, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """True elongations and forces, NaN where the truth is not known as a whole."""
    response, unknown = truth.response, np.full(shape, np.nan)
    known = truth.parameters is not None and np.isfinite(response.velocity).all()
    if not known or set(truth.parameters or ()) != set(structure.parameters):
        return unknown, unknown
    e, de = (structure.elongation(x) for x in response.stretching)
    force = structure.connection_force(e, de, truth.parameters, response.hidden)
    return e[:, structure.added], force[:, structure.added]
