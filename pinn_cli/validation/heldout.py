"""Sensors that the estimator never sees, predicted by it: cross-validation over the observed DOFs.

Whole sensors rather than samples: a sample between two others is interpolated by any network, whereas a response where
there was no sensor is what the estimate is for.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from pinn_cli.record.channels import channels
from pinn_cli.record.record import Record
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import entries, is_whole_number
from pinn_cli.training.estimate import Estimate
from pinn_cli.validation.validation import Setup, Withheld, channel_noise, compared


class HeldOut(Withheld):
    """One DOF at a time loses all its response sensors, and they are compared with what is predicted there.

    Args:
        dofs: Whose sensors are withheld, one after the other, counted from 1; None: every observed DOF's.

    Raises:
        InputError: Something else than that.
    """

    name = "heldout"
    over = "withheld_dof"

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
        if not set(self.dofs or ()) <= set(observed.tolist()):
            raise InputError("validation.dofs", self.dofs, f"observed DOFs: {', '.join(map(str, observed))}")
        for dof in self.parts(record):
            self.without(dof, problem, setup)

    def parts(self, record: Record) -> Sequence[int]:
        """DOFs, from 1."""
        return self.dofs or [int(dof) + 1 for dof in np.flatnonzero(record.observed)]

    def without(self, part: int, problem: JointProblem, setup: Setup) -> JointProblem:
        """Without one DOF's response sensors."""
        record = problem.alone.record
        remaining = record.only(lambda channel: channel.is_input or part - 1 not in channel.weights)
        return setup.scheme.with_record(problem, setup.prescribed, remaining)

    def in_words(self, part: int, record: Record) -> str:
        """See :meth:`Withheld.in_words`."""
        return f"without the sensors of DOF {record.dof_name(part - 1)}"

    def rows(self, part: int, record: Record, estimate: Estimate, setup: Setup) -> Iterator[dict[str, Any]]:
        """See :meth:`Withheld.rows`."""
        for channel in channels(record):
            if channel.dof == part - 1:
                mean, std = channel.of(estimate.response), channel.of(estimate.std)
                agreement = compared(channel.measured, mean, std, channel_noise(record, channel))
                samples = len(channel.measured)
                yield {"withheld_dof": part, "quantity": channel.quantity, "samples": samples, **agreement}
