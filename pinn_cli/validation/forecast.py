"""Blocks of time that the estimator never sees, forecast from what it found before them: for a single sensor.

A gap between samples is no test of an estimate, unless it lasts much longer than the motion remembers. After the last
sample that is seen the estimate has nothing to go by but its state there, its parameters and the force.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from pinn_cli.record.channels import channels
from pinn_cli.record.free_run import free_run_of
from pinn_cli.record.record import MINIMUM_SAMPLES, Record
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import fraction, whole_number
from pinn_cli.training.estimate import Estimate, estimated_structure
from pinn_cli.validation.validation import Setup, Withheld, channel_noise, compared

# The forecast begins this share of what was seen before its end, where the ends of splines do not show.
LEAD = 1 / 32


class Forecast(Withheld):
    """Mean over blocks and sensors of log(error of the forecast / noise of the sensor).

    The last part of the record is cut into blocks. For each the problem is solved with the record up to it, and the
    estimated system is simulated from its estimated state under the measured force to the block's end.

    Args:
        blocks: How many.
        share: Of the record, in each of them.

    Raises:
        InputError: Something else than that.
    """

    name = "forecast"
    over = "dof"

    def __init__(self, blocks: int = 3, share: float = 0.2) -> None:
        self.blocks = whole_number("validation.blocks", blocks, least=1)
        self.share = fraction("validation.share", share)

    def check(self, problem: JointProblem, setup: Setup) -> None:
        """See :meth:`Validation.check`."""
        record = problem.alone.record
        if record.unmeasured:
            hint = f"{record.unmeasured} is neither measured nor known to be zero"
            raise InputError("validation", self.name, "used with a record of which all that acts is known", hint)
        starts, length = self.parts(record), self._length(record)
        if min(length, starts[0]) < MINIMUM_SAMPLES:
            allowed = f"{MINIMUM_SAMPLES} samples or more in each block and before the first"
            hint = f"with validation.blocks={self.blocks} there are {length} and {max(0, starts[0])}"
            raise InputError("validation.share", self.share, allowed, hint)
        for start in starts:
            self.without(start, problem, setup)

    def _length(self, record: Record) -> int:
        """Samples of a block."""
        return round(self.share * len(record.time))

    def parts(self, record: Record) -> Sequence[int]:
        """First sample of each block; what is left of the record lies before them."""
        return [len(record.time) - blocks * self._length(record) for blocks in range(self.blocks, 0, -1)]

    def without(self, part: int, problem: JointProblem, setup: Setup) -> JointProblem:
        """With the record up to a block."""
        return setup.scheme.with_record(problem, setup.prescribed, problem.alone.record.until(part))

    def in_words(self, part: int, record: Record) -> str:
        """See :meth:`Withheld.in_words`."""
        return f"with the record up to {record.time[part]:.4g} s"

    def rows(self, part: int, record: Record, estimate: Estimate, setup: Setup) -> Iterator[dict[str, Any]]:
        """See :meth:`Withheld.rows`."""
        first, end = part - max(1, round(LEAD * part)), part + self._length(record)
        structure = estimated_structure(setup.prescribed, estimate.parameters)
        forecast = free_run_of(structure, record.until(end), estimate.response, first, first)
        for channel in channels(record):
            measured = channel.measured[part:end]
            mean = channel.of(forecast)[-len(measured) :]
            agreement = compared(measured, mean, np.full_like(mean, np.nan), channel_noise(record, channel))
            where = {"withheld_from": record.time[part], "dof": channel.dof + 1, "quantity": channel.quantity}
            scores = {name: agreement[name] for name in ("noise_std", "error_rms", "score")}
            yield {**where, "samples": len(measured), **scores}
