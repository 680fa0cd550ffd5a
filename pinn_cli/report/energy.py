"""Energy that every connection dissipates over the record (``energy.csv``)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pinn_cli.report.results import with_labels
from pinn_cli.system.energy import dissipated_power, stored_by_memory, trapezoids
from pinn_cli.training.central_interval import HALF_WIDTH_90
from pinn_cli.training.estimated_structure import estimated_structure

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pinn_cli.record.response import Response
    from pinn_cli.system.structure import Structure
    from pinn_cli.training.estimate import Estimate

COLUMNS = ("connection", "dissipated", "std", "lower_90", "upper_90", "share_percent", "true", "error_percent")


@dataclass(frozen=True, eq=False)
class DissipatedEnergy:
    """Of C connections, `Structure.added`.

    Attributes:
        names: Of the connections; their numbers from 1 where they have none.
        estimate: (C,), J.
        std: (C,), J; NaN where the estimator gives none.
        true: (C,), J; NaN where unknown.
    """

    names: tuple[str, ...]
    estimate: np.ndarray
    std: np.ndarray
    true: np.ndarray

    @classmethod
    def of(
        cls, prescribed: Structure, estimate: Estimate, truth: Response, true: Structure | None = None
    ) -> DissipatedEnergy:
        """Of an estimate.

        Args:
            prescribed: Whose connections they are.
            estimate: Of a training that says nothing of the energy, its motion and parameters do, without a deviation.
            truth: NaN where unknown.
            true: The structure that a simulated record comes from; None: the truth is not known.
        """
        found = estimate.connections
        structure = estimated_structure(prescribed, estimate.parameters)
        energy = None if found is None else found.dissipated
        energy = dissipated(structure, estimate.response) if energy is None else energy
        std = None if found is None else found.dissipated_std
        unknown = np.full(len(energy), np.nan)
        known = true is not None and len(true.added) == len(energy) and np.isfinite(truth.velocity).all()
        return cls(
            tuple(structure.labels.connection(i) for i in structure.added),
            energy,
            unknown if std is None else std,
            dissipated(true, truth) if true is not None and known else unknown,
        )


def dissipated(structure: Structure, response: Response) -> np.ndarray:
    """(C,), J: energy dissipated by `Structure.added` in a motion; NaN where a hidden force of it is not known."""
    e, de = (structure.elongation(x) for x in response.stretching)
    parameters, z = structure.parameters_like(e), response.hidden
    if len(structure.memory) and z is None:
        z = np.full((len(e), len(structure.memory)), np.nan)
    energy = trapezoids(response.time) @ dissipated_power(structure, e, de, parameters, z)
    if z is not None:
        stored = stored_by_memory(structure, z[[0, -1]], parameters)
        energy[structure.memory] += stored[0] - stored[1]
    out: np.ndarray = energy[structure.added]
    return out


def energy_table(energy: DissipatedEnergy, labels: Mapping[str, object]) -> pd.DataFrame:
    """One row per connection (the content of ``energy.csv``).

    Args:
        energy: Of the estimate.
        labels: A value for each of `pinn_cli.report.results.LABELS`.

    Returns:
        Columns: the labels and `COLUMNS`. Energies are in J, ``share_percent`` is of the sum over all connections.
        Cells of what is not known are empty (NaN).
    """
    found, half = energy.estimate, HALF_WIDTH_90 * energy.std
    total = float(np.sum(found))
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.where(energy.true != 0.0, 100.0 * np.abs(found - energy.true) / np.abs(energy.true), np.nan)
    table = pd.DataFrame(
        {
            "connection": energy.names,
            "dissipated": found,
            "std": energy.std,
            "lower_90": found - half,
            "upper_90": found + half,
            "share_percent": 100.0 * found / total if total > 0.0 else np.full(len(found), np.nan),
            "true": energy.true,
            "error_percent": error,
        },
        columns=list(COLUMNS),
    )
    return with_labels(table, labels)
