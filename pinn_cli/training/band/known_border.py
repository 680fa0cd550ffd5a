"""Normal equations whose parameters something else has told already: they stay, and what they leave open is told."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pinn_cli.training.band.bordered import BorderedFactor, BorderedSystem


@dataclass(frozen=True, eq=False)
class KnownBorderSystem(BorderedSystem):
    """A system whose step leaves the parameters where they are.

    Attributes:
        covariance: (p, p), of the parameters; the readout weights' own is that about the parameters and what these add.
    """

    covariance: np.ndarray = field(kw_only=True)

    def factor(self, damping: float = 0.0) -> BorderedFactor | None:
        """See :meth:`BorderedSystem.factor`."""
        eliminated = self.eliminated(damping)
        found = None if eliminated is None else eliminated.factor(np.linalg.inv(self.covariance))
        return None if found is None else KnownBorderFactor(found.readout, found.schur)


@dataclass(frozen=True, eq=False)
class KnownBorderFactor(BorderedFactor):
    """A factored :class:`KnownBorderSystem`."""

    def reduced(self, system: BorderedSystem) -> tuple[np.ndarray, np.ndarray]:
        """See :meth:`BorderedFactor.reduced`: nothing pulls at the parameters."""
        half, right = super().reduced(system)
        return half, np.zeros_like(right)
