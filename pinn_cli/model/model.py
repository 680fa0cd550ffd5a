"""What a finished run knows of its structure."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.model.knowledge import EndState, Levels, Misfit, ParameterKnowledge

if TYPE_CHECKING:
    from pinn_cli.system.parameters import Parameter
    from pinn_cli.system.structure import Structure


@dataclass(frozen=True, eq=False)
class Model:
    """An identified structure: no truth is in it, only what was prescribed and what was found.

    Attributes:
        structure: With the estimates in place.
        parameters: Those that were uncertain, p of them; ``prescribed`` is their mean.
        known: Of them; its covariance is NaN where the training told no standard deviations.
        draws: (D, p), of a sampled posterior; None without one.
        misfit: The force that the model leaves out; None where the training does not say.
        levels: Noise that was found.
        end: Where the motion ended; None where nobody knows.
        verdict: On the run, and the first reason for it; "" without one.
        reason: Likewise.
        directory: Of the run.
    """

    structure: Structure
    parameters: tuple[Parameter, ...]
    known: ParameterKnowledge
    levels: Levels
    end: EndState | None
    verdict: str
    reason: str
    draws: np.ndarray | None = None
    directory: Path = Path()
    misfit: Misfit | None = None

    @property
    def lower(self) -> np.ndarray:
        """(p,), least values of the parameters; -inf without one."""
        return np.array([0.0 if p.positive else -np.inf for p in self.parameters])
