"""What a posterior consists of once it has been found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class PosteriorSamples:
    """Draws from the posterior and the prior, and how they came about.

    Attributes:
        method: ``marginal``, ``conditional`` or ``laplace``.
        names: The p parameters, ``c_1``, ``k_2``, ...
        draws: (chains, draws, p), SI units.
        sigma_force: (chains, draws, F), N, noise of the F measured forces.
        force_dofs: (F,), DOFs of those, counted from 1.
        prior: (draws, p).
        statistics: ArviZ's names of sample statistics (``diverging``, ``acceptance_rate``, ``n_steps``, ``tree_depth``,
            ``lp``, ...) to (chains, draws); empty where nothing was sampled step by step (``laplace``).
        warmup: Iterations before the first draw kept, of each chain.
        seconds: (chains,), of sampling.
    """

    method: str
    names: tuple[str, ...]
    draws: np.ndarray
    sigma_force: np.ndarray
    force_dofs: np.ndarray
    prior: np.ndarray
    statistics: dict[str, np.ndarray]
    warmup: int
    seconds: np.ndarray
