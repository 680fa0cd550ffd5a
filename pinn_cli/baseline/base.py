"""What a baseline is: another estimator of the same problem, to compare with."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from pinn_cli.scheme.problem import Problem
from pinn_cli.training.estimate import Estimate, RunContext


class Baseline(ABC):
    """An estimator beside the network. A new one is a file here and a file in ``conf/baseline``.

    Attributes:
        name: What the tables call it in their column ``estimator``.
    """

    name: ClassVar[str]

    @abstractmethod
    def solve(self, problem: Problem, run: RunContext) -> Estimate | None:
        """Estimate the same problem from the same record; None where there is no such estimate.

        A baseline that fails says so in the log and returns None: the network's estimate is not lost for it.
        """
