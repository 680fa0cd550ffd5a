"""Blocks of time that the estimator never sees, forecast from what it found before them: for a single sensor.

A gap between samples is no test of an estimate, unless it lasts much longer than the motion remembers. After the last
sample that is seen the estimate has nothing to go by but its state there, its parameters and the force.
"""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
import pandas as pd

from pinn_cli.record.channels import channels
from pinn_cli.record.free_run import NoFreeRunError, free_run_of
from pinn_cli.record.record import MINIMUM_SAMPLES, Record
from pinn_cli.record.response import Response
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.settings.errors import DivergenceError, InputError
from pinn_cli.settings.legal_values import fraction, whole_number
from pinn_cli.training.estimate import Estimate
from pinn_cli.training.estimated_structure import estimated_structure
from pinn_cli.validation.base import Score, Setup, Validation
from pinn_cli.validation.density import channel_noise, compared

log = logging.getLogger(__name__)

# The forecast begins this share of what was seen before its end, where the ends of splines do not show.
LEAD = 1 / 32


class Forecast(Validation):
    """Mean over blocks and sensors of log(error of the forecast / noise of the sensor).

    The last part of the record is cut into blocks. For each the problem is posed and solved again with the record up to
    it, and the estimated system is simulated from its estimated state under the measured force to the block's end. The
    run's own estimate is left as it is.

    Args:
        blocks: How many.
        share: Of the record, in each of them.

    Raises:
        InputError: Something else than that.
    """

    name = "forecast"

    def __init__(self, blocks: int = 3, share: float = 0.2) -> None:
        self.blocks = whole_number("validation.blocks", blocks, least=1)
        self.share = fraction("validation.share", share)

    def check(self, problem: JointProblem, setup: Setup) -> None:
        """See :meth:`Validation.check`."""
        record = problem.alone.record
        unknown = np.flatnonzero(np.isnan(record.force).any(axis=0))
        if unknown.size:
            hint = f"that on {record.dof_names(unknown)} is neither measured nor known to be zero"
            raise InputError("validation", self.name, "used with a record whose forces are all known", hint)
        starts, length = self._starts(record), self._length(record)
        if min(length, starts[0]) < MINIMUM_SAMPLES:
            allowed = f"{MINIMUM_SAMPLES} samples or more in each block and before the first"
            hint = f"with validation.blocks={self.blocks} there are {length} and {max(0, starts[0])}"
            raise InputError("validation.share", self.share, allowed, hint)
        for start in starts:
            self._up_to(start, problem, setup)

    def score(self, problem: JointProblem, estimate: Estimate, setup: Setup) -> Score:
        """See :meth:`Validation.score`."""
        rows: list[dict[str, Any]] = []
        record = problem.alone.record
        for start in self._starts(record):
            try:
                before = self._up_to(start, problem, setup)
                found = setup.estimator.solve(before, setup.run)
                forecast = _forecast(record, found, setup, start, start + self._length(record))
            except (DivergenceError, NoFreeRunError) as error:
                reason = f"with the record up to {record.time[start]:.4g} s: {error}"
                log.warning("no validation score: %s", reason)
                return Score(np.nan, pd.DataFrame(rows), reason)
            rows += self._rows(record, forecast, start)
        return Score.mean(rows, over="dof")

    def _length(self, record: Record) -> int:
        """Samples of a block."""
        return round(self.share * len(record.time))

    def _starts(self, record: Record) -> list[int]:
        """First sample of each block; what is left of the record lies before them."""
        return [len(record.time) - left * self._length(record) for left in range(self.blocks, 0, -1)]

    def _up_to(self, start: int, problem: JointProblem, setup: Setup) -> JointProblem:
        """The same problem with the record up to a block."""
        return setup.scheme.with_record(problem, setup.prescribed, problem.alone.record.until(start))

    def _rows(self, record: Record, forecast: Response, start: int) -> list[dict[str, Any]]:
        rows = []
        for channel in channels(record):
            measured = channel.measured[start : start + self._length(record)]
            mean = channel.of(forecast)[-len(measured) :]
            agreement = compared(measured, mean, np.full_like(mean, np.nan), channel_noise(record, channel))
            rows.append(
                {
                    "validation": self.name,
                    "withheld_from": record.time[start],
                    "dof": channel.dof + 1,
                    "quantity": channel.quantity,
                    "samples": len(measured),
                    "noise_std": agreement.noise,
                    "error_rms": agreement.error,
                    "score": agreement.excess,
                }
            )
        return rows


def _forecast(record: Record, found: Estimate, setup: Setup, start: int, end: int) -> Response:
    """From shortly before a block to its end."""
    first = start - max(1, round(LEAD * start))
    structure = estimated_structure(setup.prescribed, found.parameters)
    return free_run_of(structure, record.until(end), found.response, first, first)
