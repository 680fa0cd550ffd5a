"""Natural frequencies, damping ratios and mode shapes of the estimated structure (``modes.csv``)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from pinn_cli.report.estimates import error_percent
from pinn_cli.system.modes import NaturalModes, frequency
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import Estimate
from pinn_cli.training.estimated_structure import estimated_structure
from pinn_cli.training.propagation import half_widths_90


@dataclass(frozen=True, eq=False)
class OtherModes:
    """What another structure does in the modes that are most like those of the estimated one; NaN where it has none.

    Attributes:
        mac: (modes,), modal assurance criterion.
        frequencies: (modes,), Hz.
        damping_ratios: (modes,).
        shapes: (dofs, modes), with the sign of the estimated ones.
    """

    mac: np.ndarray
    frequencies: np.ndarray
    damping_ratios: np.ndarray
    shapes: np.ndarray

    @classmethod
    def of(cls, structure: Structure | None, found: NaturalModes) -> OtherModes:
        """Of a structure with as many modes as those that were found."""
        other = None if structure is None else NaturalModes.of(structure)
        if other is None or other.of_dofs.shape != found.of_dofs.shape:
            nothing = np.full(len(found.squares), np.nan)
            return cls(nothing, nothing, nothing, np.full(found.of_dofs.shape, np.nan))
        to, every = found.partners(other), np.arange(len(found.squares))
        sign = np.where(np.sum(found.shapes * other.shapes[:, to], axis=0) < 0, -1.0, 1.0)
        mac = found.assurance(other)[every, to]
        return cls(mac, other.frequencies[to], other.damping_ratios[to], sign * other.shapes[:, to])


@dataclass(frozen=True, eq=False)
class ModeEstimates:
    """Modes of the estimated structure, linearised about rest, beside those of two others.

    Attributes:
        dofs: Names of the DOFs; their numbers from 1 where they have none.
        is_chain: Whether each DOF follows the one before.
        frequencies, damping_ratios: (modes,), Hz.
        frequency_interval, damping_interval: (2, modes), central 90 % intervals; NaN where nothing is uncertain.
        shapes: (dofs, modes), the largest displacement being one.
        prescribed: Of the model that the estimator was given.
        true: Of the structure that a simulated record comes from.
    """

    dofs: tuple[str, ...]
    is_chain: bool
    frequencies: np.ndarray
    damping_ratios: np.ndarray
    frequency_interval: np.ndarray
    damping_interval: np.ndarray
    shapes: np.ndarray
    prescribed: OtherModes
    true: OtherModes

    @classmethod
    def of(cls, prescribed: Structure, estimate: Estimate, true: Structure | None = None) -> ModeEstimates | None:
        """Of an estimate; None where its parameters make no structure, a mass being zero.

        The intervals are those that the parameters' own ones and their correlation make to first order, of omega^2 and
        of the damping ratio: what is held fixed counts as exact.
        """
        structure = estimated_structure(prescribed, estimate.parameters)
        modes = NaturalModes.of(structure)
        if modes is None:
            return None
        intervals = []
        slopes = modes.slopes([found.parameter for found in estimate.parameters])
        for values, slope in zip((modes.squares, modes.damping_ratios), slopes, strict=True):
            below, above = half_widths_90(slope, estimate.parameters, estimate.correlation)
            intervals.append(np.stack((values - below, values + above)))
        squares, ratios = intervals
        return cls(
            tuple(structure.dof_name(i) for i in range(structure.ndof)),
            not structure.is_modal and not structure.labels.connections,
            modes.frequencies,
            modes.damping_ratios,
            frequency(np.where(squares < 0, 0.0, squares)),
            ratios,
            modes.shapes,
            OtherModes.of(prescribed, modes),
            OtherModes.of(true, modes),
        )

    @property
    def count(self) -> int:
        """Of modes."""
        return len(self.frequencies)


def mode_table(modes: ModeEstimates) -> pd.DataFrame:
    """One row per mode, the lowest frequency first (the content of ``modes.csv``).

    Frequencies are in Hz and undamped; ``lower_90`` and ``upper_90`` are of the frequency. ``mac`` is the modal
    assurance criterion against the prescribed mode that is most alike, whose frequency and damping follow; ``true_mac``
    the same of the true one. A column ``shape_<dof>`` per DOF is its displacement where the mode's largest is one.
    Cells of what is not known are empty (NaN).
    """
    prescribed, true = modes.prescribed, modes.true
    columns: dict[str, np.ndarray] = {
        "mode": np.arange(1, modes.count + 1),
        "frequency": modes.frequencies,
        "lower_90": modes.frequency_interval[0],
        "upper_90": modes.frequency_interval[1],
        "damping_ratio": modes.damping_ratios,
        "damping_ratio_lower_90": modes.damping_interval[0],
        "damping_ratio_upper_90": modes.damping_interval[1],
        "mac": prescribed.mac,
        "prescribed_frequency": prescribed.frequencies,
        "prescribed_damping_ratio": prescribed.damping_ratios,
        "true_frequency": true.frequencies,
        "true_damping_ratio": true.damping_ratios,
        "frequency_error_percent": error_percent(modes.frequencies, true.frequencies),
        "damping_ratio_error_percent": error_percent(modes.damping_ratios, true.damping_ratios),
        "true_mac": true.mac,
    }
    return pd.DataFrame(columns | {f"shape_{dof}": row for dof, row in zip(modes.dofs, modes.shapes, strict=True)})
