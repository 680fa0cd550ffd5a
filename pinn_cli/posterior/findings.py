"""All that is known about the parameters once they have been sampled: what the report is made from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas as pd

    from pinn_cli.posterior.samples import PosteriorSamples


@dataclass(frozen=True, eq=False)
class ForcePredictive:
    """Draws of the measured forces from the posterior predictive distribution, for some of the draws and the times.

    Attributes:
        draws: (D,), which draws of every chain, counted from 0.
        samples: (T,), which samples of the record, counted from 0, in equal steps.
        force: (chains, D, T, F), N, with the noise that the record has (that of the mean of repeated measurements); the
            DOFs are the posterior's ``force_dofs``.

    Raises:
        ValueError: The shape of ``force`` does not fit.
    """

    draws: np.ndarray
    samples: np.ndarray
    force: np.ndarray

    def __post_init__(self) -> None:
        if self.force.ndim != 4 or self.force.shape[1:3] != (len(self.draws), len(self.samples)):
            expected = f"(chains, {len(self.draws)}, {len(self.samples)}, dofs)"
            raise ValueError(f"the predicted force has shape {self.force.shape}; it must be {expected}")


@dataclass(frozen=True, eq=False)
class PosteriorFindings:
    """A posterior, whether its sampling can be trusted, and what it predicts.

    Attributes:
        samples: The draws.
        diagnostics: One row per parameter: ``parameter``, ``mean``, ``std``, ``lower_90``, ``upper_90``, ``r_hat``,
            ``ess_bulk``, ``ess_tail``, ``mcse_mean``; NaN where there was no sampling.
        verdict: Why the quality check failed, one sentence each; none if it passed.
        predictive: Of the measured forces; None where it was not drawn.
    """

    samples: PosteriorSamples
    diagnostics: pd.DataFrame
    verdict: tuple[str, ...] = ()
    predictive: ForcePredictive | None = None
