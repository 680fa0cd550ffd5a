"""What a validation is: a score of an estimate that knows nothing of the truth."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import pandas as pd

from pinn_cli.scheme.base import Scheme
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.system.structure import Structure
from pinn_cli.training.base import Estimator
from pinn_cli.training.estimate import Estimate, RunContext


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

    @classmethod
    def mean(cls, rows: Sequence[Mapping[str, Any]], over: str) -> Score:
        """The mean of the column ``score`` of rows, which ends the table where the column ``over`` says `all`."""
        table = pd.DataFrame(rows)
        value = float(table["score"].mean())
        samples = int(table["samples"].sum())
        last = {"validation": rows[0]["validation"], over: "all", "samples": samples, "score": value}
        reason = "" if math.isfinite(value) else "the prediction is not finite"
        return cls(value, pd.concat([table, pd.DataFrame([last])], ignore_index=True), reason)


class Validation(ABC):
    """How an estimate is scored from measurements alone. A new one is a file here and a file in ``conf/validation``.

    Attributes:
        name: What score.csv calls it.
        scores_records: Whether it scores what several records were solved for together.
    """

    name: ClassVar[str]
    scores_records: ClassVar[bool] = False

    @abstractmethod
    def check(self, problem: JointProblem, setup: Setup) -> None:
        """Refuse, before anything is trained, what cannot be scored.

        Raises:
            InputError: There is nothing to score with.
        """

    @abstractmethod
    def score(self, problem: JointProblem, estimate: Estimate, setup: Setup) -> Score | None:
        """The score; None where none was asked for.

        Args:
            problem: That was solved.
            estimate: Its solution.
            setup: That found it, to find others.
        """
