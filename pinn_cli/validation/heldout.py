"""Sensors that the estimator never sees, predicted by it: cross-validation over the observed DOFs.

Whole sensors rather than samples: a sample between two others is interpolated by any network, whereas a response where
there was no sensor is what the estimate is for.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from pinn_cli.record.channels import channels
from pinn_cli.record.record import Record
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.settings.errors import DivergenceError, InputError
from pinn_cli.settings.legal_values import entries, is_whole_number
from pinn_cli.training.estimate import Estimate
from pinn_cli.validation.base import Score, Setup, Validation
from pinn_cli.validation.density import channel_noise, compared

log = logging.getLogger(__name__)


class HeldOut(Validation):
    """Mean over withheld channels of how well they were predicted (:func:`pinn_cli.validation.density.compared`).

    One DOF at a time loses all its response sensors, the problem is posed and solved again without them, and they are
    compared with what it predicts there. The run's own estimate, from all sensors, is left as it is.

    Args:
        dofs: Whose sensors are withheld, one after the other, counted from 1; None: every observed DOF's.

    Raises:
        InputError: Something else than that.
    """

    name = "heldout"

    def __init__(self, dofs: Sequence[int] | None = None) -> None:
        given = entries(dofs)
        if dofs is not None and (not given or not all(is_whole_number(dof) and dof >= 1 for dof in given)):
            raise InputError("validation.dofs", dofs, "null or a list of observed DOFs, counted from 1")
        self.dofs = None if dofs is None else sorted({int(dof) for dof in given})

    def check(self, problem: JointProblem, setup: Setup) -> None:
        """See :meth:`Validation.check`."""
        record = problem.alone.record
        observed = np.flatnonzero(record.observed) + 1
        if len(observed) < 2:
            hint = "with one DOF observed there is none to spare; validation=forecast withholds blocks of time"
            raise InputError("validation", self.name, "used with sensors on two DOFs or more", hint)
        for dof in self.dofs or ():
            if dof not in observed:
                raise InputError("validation.dofs", self.dofs, f"observed DOFs: {', '.join(map(str, observed))}")
        for dof in self._withheld(record):
            self._without(dof, problem, setup)

    def score(self, problem: JointProblem, estimate: Estimate, setup: Setup) -> Score:
        """See :meth:`Validation.score`."""
        rows: list[dict[str, Any]] = []
        record = problem.alone.record
        for dof in self._withheld(record):
            reduced = self._without(dof, problem, setup)
            try:
                found = setup.estimator.solve(reduced, setup.run)
            except DivergenceError as error:
                reason = f"without the sensors of DOF {record.dof_name(dof - 1)}: {error}"
                log.warning("no validation score: %s", reason)
                return Score(np.nan, pd.DataFrame(rows), reason)
            rows += self._rows(record, dof, found)
        return Score.mean(rows, over="withheld_dof")

    def _withheld(self, record: Record) -> list[int]:
        return self.dofs or [int(dof) + 1 for dof in np.flatnonzero(record.observed)]

    def _without(self, dof: int, problem: JointProblem, setup: Setup) -> JointProblem:
        """The same problem without one DOF's response sensors."""
        record = problem.alone.record
        left = {q: [int(d) + 1 for d in np.flatnonzero(record.sensors(q)) if d + 1 != dof] for q in RESPONSE_QUANTITIES}
        return setup.scheme.with_record(problem, setup.prescribed, record.keep(left))

    def _rows(self, record: Record, dof: int, found: Estimate) -> list[dict[str, Any]]:
        rows = []
        for channel in channels(record):
            if channel.dof != dof - 1:
                continue
            mean, std = channel.of(found.response), channel.of(found.std)
            agreement = compared(channel.measured, mean, std, channel_noise(record, channel))
            rows.append(
                {
                    "validation": self.name,
                    "withheld_dof": dof,
                    "quantity": channel.quantity,
                    "samples": len(channel.measured),
                    "noise_std": agreement.noise,
                    "error_rms": agreement.error,
                    "standardised_error_rms": agreement.standardised,
                    "coverage_95_percent": 100.0 * agreement.coverage,
                    "score": agreement.excess,
                }
            )
        return rows
