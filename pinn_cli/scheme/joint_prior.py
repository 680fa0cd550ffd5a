"""What earlier records leave known of parameters: a prior in which they are correlated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pinn_cli.model.knowledge import Levels, ParameterKnowledge


@dataclass(frozen=True, eq=False)
class JointPrior:
    """Beside the means and standard deviations that the parameters themselves have; p of them.

    Attributes:
        correlation: (p, p).
        first_std: (p,), what the prior before the first record allowed, in the parameters' units.
        told, weight: See :class:`pinn_cli.model.knowledge.ParameterKnowledge`; of the records before this one.
        prescribed, spread: Likewise; of the first prior.
        levels: Noise that the last record was found to have: near it this one's is looked for.
    """

    correlation: np.ndarray
    first_std: np.ndarray
    told: np.ndarray
    weight: np.ndarray
    levels: Levels
    prescribed: np.ndarray | None = None
    spread: float = 1.0

    @classmethod
    def of(cls, known: ParameterKnowledge, levels: Levels) -> JointPrior:
        """What earlier records say."""
        std = np.sqrt(np.diag(known.covariance))
        correlation = known.covariance / np.outer(std, std)
        return cls(correlation, known.first_std, known.told, known.weight, levels, known.prescribed, known.spread)

    def known(self, mean: np.ndarray, std: np.ndarray) -> ParameterKnowledge:
        """The same as knowledge, with the parameters' means and standard deviations (p,)."""
        covariance = self.correlation * np.outer(std, std)
        before = self.told, self.weight, self.first_std, self.prescribed, self.spread
        return ParameterKnowledge(mean, covariance, *before)

    @cached_property
    def precision(self) -> np.ndarray:
        """(p, p), the inverse of the correlation."""
        root = np.linalg.inv(np.linalg.cholesky(self.correlation))
        inverse: np.ndarray = root.T @ root
        return inverse

    def with_independent(self, std: Sequence[float]) -> JointPrior:
        """With parameters behind these that have nothing to do with them, and their standard deviations."""
        p, more = len(self.correlation), len(std)
        correlation = np.eye(p + more)
        correlation[:p, :p] = self.correlation
        nothing = np.zeros(more)
        return replace(
            self,
            correlation=correlation,
            first_std=np.concatenate((self.first_std, std)),
            told=np.concatenate((self.told, nothing)),
            weight=np.concatenate((self.weight, nothing)),
            prescribed=None if self.prescribed is None else np.append(self.prescribed, np.full(more, np.nan)),
        )
