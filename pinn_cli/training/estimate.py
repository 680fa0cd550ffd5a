"""What a training hands to the report."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from pinn_cli.record.record import Response

if TYPE_CHECKING:
    from pinn_cli.runs.checkpoint import Checkpoints
    from pinn_cli.training.band.parameter_likelihoods import ParameterLikelihoods

# Called with each row of a history as it comes; it must not change it.
Watch = Callable[[Mapping[str, float]], None]


def unwatched(row: Mapping[str, float]) -> None:
    """Nobody looks on."""


@dataclass(frozen=True, eq=False)
class ParameterEstimate:
    """One system parameter after training.

    Attributes:
        name: Kind and connection, counted from 1: ``k_2``, ``kappa_4``.
        prescribed: The value that the estimator was given: believed, or where an unknown one started (`start`).
        estimate: The value that it found.
        std: Posterior standard deviation, NaN where the training gives none.
        lower_90, upper_90: The central 90 % interval.
        prior_std: Prior standard deviation, NaN where there was none.
        unknown: Whether it was identified from the record alone; otherwise it was prescribed and merely uncertain.
        held: Whether its most probable value is the bound that it cannot pass; the estimate may lie above, being a
            mean.
    """

    name: str
    prescribed: float
    estimate: float
    std: float
    lower_90: float
    upper_90: float
    prior_std: float = math.nan
    unknown: bool = False
    held: bool = False

    @property
    def start(self) -> float:
        """Where the search for an unknown one started; NaN of one that was prescribed."""
        return self.prescribed if self.unknown else math.nan

    @property
    def believed(self) -> float:
        """What was prescribed; NaN of an unknown one, of which nothing was."""
        return math.nan if self.unknown else self.prescribed


@dataclass(frozen=True, eq=False)
class Estimate:
    """The estimated motion of every DOF, its uncertainty, the parameters, and how they were found.

    Attributes:
        response: Posterior mean of every quantity at the record's times, (N, n).
        std: Posterior standard deviation of the same; NaN where the training gives none.
        parameters: The parameters that were uncertain, in the order of the connections.
        history: One row per iteration: ``iteration``, ``seconds``, every loss term ``loss_*`` and every weight
            ``weight_*``.
        summary: Iterations, stop reason, noise levels and the like, for run.json.
        correlation: (p, p), posterior correlation of ``parameters``, None where the training gives none.
        likelihoods: Of the parameters, for a sampler; None where no posterior distribution was asked for.
    """

    response: Response
    std: Response
    parameters: list[ParameterEstimate]
    history: pd.DataFrame
    summary: dict[str, Any]
    correlation: np.ndarray | None = None
    likelihoods: ParameterLikelihoods | None = None


@dataclass(frozen=True, eq=False)
class RunContext:
    """What a training may know about the run that it is part of.

    Attributes:
        device: Where networks and residuals live, ``cpu`` or ``cuda``.
        seed: Seeds the weights of networks that start from random ones.
        directory: The run's directory, for what a stage keeps; None in a library call that keeps nothing.
        progress: Whether to draw a progress bar (never when the output is no terminal).
        checkpoints: Of the trainings; None in a library call that keeps none.
        watch: Who looks on as the history grows.
    """

    device: str = "cpu"
    seed: int = 0
    directory: Path | None = None
    progress: bool = field(default=False)
    checkpoints: Checkpoints | None = None
    watch: Watch = unwatched
