"""What a validation is: a score of an estimate that knows nothing of the truth."""

from __future__ import annotations

import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from pinn_cli.record.channel import Channel
from pinn_cli.record.channels import FINEST_KNOWN, record_band
from pinn_cli.record.free_run import NoFreeRunError
from pinn_cli.record.record import Record
from pinn_cli.record.spectrum import white_level
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.scheme import Scheme
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.training.estimator import Estimator

log = logging.getLogger(__name__)

# Of the 95 % band of a normal distribution.
NINETY_FIVE_PERCENT = 1.959963984540054


@dataclass(frozen=True, eq=False)
class Setup:
    """All that an estimate is made of but the measurements; there is no way from here to the truth.

    Attributes:
        prescribed: The chain that the user prescribes.
        scheme: How the problem is posed.
        estimator: How it is solved.
        run: The run that all this is part of.
    """

    prescribed: Structure
    scheme: Scheme
    estimator: Estimator
    run: RunContext


@dataclass(frozen=True, eq=False)
class Score:
    """What came of a validation.

    Attributes:
        value: Lower is better; NaN where none could be found.
        table: Where it comes from, for score.csv.
        reason: Why it is NaN, in one line; empty otherwise.
    """

    value: float
    table: pd.DataFrame
    reason: str = ""


class Validation(ABC):
    """How an estimate is scored from measurements alone. A new one is a file here and a file in ``conf/validation``.

    Attributes:
        name: What score.csv calls it.
        scores_records: Whether it scores what several records were solved for together.
    """

    name: ClassVar[str]
    scores_records: ClassVar[bool] = False

    def check(self, problem: JointProblem, setup: Setup) -> None:  # noqa: B027 - one that scores nothing takes any
        """Refuse, before anything is trained, what there is nothing to score with."""

    @abstractmethod
    def score(self, problem: JointProblem, estimate: Estimate, setup: Setup) -> Score | None:
        """The score of a problem's solution, which ``setup`` found; None where none was asked for."""


class Withheld(Validation):
    """A validation by parts of the record that are withheld, one after the other.

    The problem is posed and solved again without each, and what is predicted there is compared with what was measured.
    The run's own estimate is left as it is. The score is the mean over all channels of all parts.

    Attributes:
        over: Column of the table that says ``all`` in the last row, that of the mean.
    """

    over: ClassVar[str]

    @abstractmethod
    def parts(self, record: Record) -> Sequence[int]:
        """What is withheld, in its order."""

    @abstractmethod
    def without(self, part: int, problem: JointProblem, setup: Setup) -> JointProblem:
        """The same problem without a part."""

    @abstractmethod
    def in_words(self, part: int, record: Record) -> str:
        """The problem without a part, in words."""

    @abstractmethod
    def rows(self, part: int, record: Record, estimate: Estimate, setup: Setup) -> Iterator[dict[str, Any]]:
        """One row per channel of a part, with what `compared` makes of it.

        Raises:
            NoFreeRunError: Nothing can be predicted.
        """

    def score(self, problem: JointProblem, estimate: Estimate, setup: Setup) -> Score:
        """See :meth:`Validation.score`."""
        rows, record = list[dict[str, Any]](), problem.alone.record
        for part in self.parts(record):
            try:
                without_part = setup.estimator.solve(self.without(part, problem, setup), setup.run)
                rows += [{"validation": self.name, **row} for row in self.rows(part, record, without_part, setup)]
            except (DivergenceError, NoFreeRunError) as error:
                reason = f"{self.in_words(part, record)}: {error}"
                log.warning("no validation score: %s", reason)
                return Score(np.nan, pd.DataFrame(rows), reason)
        table = pd.DataFrame(rows)
        value, samples = float(table["score"].mean()), int(table["samples"].sum())
        last = pd.DataFrame([{"validation": self.name, self.over: "all", "samples": samples, "score": value}])
        reason = "" if math.isfinite(value) else "the prediction is not finite"
        return Score(value, pd.concat([table, last], ignore_index=True), reason)


def compared(measured: np.ndarray, mean: np.ndarray, std: np.ndarray, noise: float) -> dict[str, float]:
    """How a withheld channel was predicted.

    Args:
        measured: (N,), with its noise.
        mean: (N,), predicted.
        std: (N,), of the response alone; NaN where unknown.
        noise: Of the measurement.

    Returns:
        ``noise_std`` and ``error_rms`` (of prediction minus measurement), in the unit of the channel.
        ``standardised_error_rms``: of the same over its predicted standard deviation, noise included; 1 where the
        spread is right. ``coverage_95_percent``: share of the measurements within the predicted 95 % band. Both are NaN
        where the training gives no spread. ``score``: the excess negative log density over a prediction that knows the
        response, nats per sample. With e the error and v = std^2 + noise^2 the predicted variance of a measurement, it
        is the mean of 1/2 [log(v / noise^2) + e^2 / v - 1]: 0 on average for the true response with no spread, larger
        for any other normal distribution (Gneiting and Raftery 2007, logarithmic score). Where the training gives no
        spread, v is the mean squared error itself, which leaves log(error / noise).
    """
    error = measured - mean
    square = float(np.mean(error**2))
    has_std = bool(np.isfinite(std).all())
    variance = std**2 + noise**2 if has_std else np.full_like(error, max(square, noise**2))
    ratio = error**2 / variance
    return {
        "noise_std": noise,
        "error_rms": square**0.5,
        "standardised_error_rms": float(np.mean(ratio)) ** 0.5 if has_std else np.nan,
        "coverage_95_percent": 100.0 * float(np.mean(ratio <= NINETY_FIVE_PERCENT**2)) if has_std else np.nan,
        "score": float(0.5 * np.mean(np.log(variance / noise**2) + ratio - 1.0)),
    }


def channel_noise(record: Record, channel: Channel) -> float:
    """White noise of a channel, read above the record's band or off its repeats: no setting of an estimator is in it.

    The record has every sensor, and the channel is one of its own.
    """
    if record.repeats is not None:
        level = float(record.repeats.noise_of_mean(channel.quantity)[channel.dof])
    else:
        level = white_level(channel.measured, record.step, 1.5 * record_band(record))
    return max(level, FINEST_KNOWN * float(np.sqrt(np.mean(channel.measured**2))))
