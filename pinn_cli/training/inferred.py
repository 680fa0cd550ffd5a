"""A solution of a problem, and how it is looked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pinn_cli.model.knowledge import DiscrepancyTold
from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.estimate import Rival
from pinn_cli.training.evidence import Evidence, Trained
from pinn_cli.training.history import History
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.point import Point
from pinn_cli.training.steps.free_running import FreeRunning
from pinn_cli.training.whittle.whittle_estimate import KnownParameters


@dataclass(frozen=True, eq=False)
class Inferred:
    """A solution, what it was found with, others that explain the record as well, and what windows told so far.

    How many times as large the deviation of an unknown parameter was before the features were last made finer. And
    where the model does not quite hold, solutions whose structure runs free.
    """

    evidence: Evidence
    trained: Trained
    rivals: tuple[Rival, ...] = ()
    told: DiscrepancyTold | None = None
    narrowed: float = 1.0
    free: Sequence[FreeRunning] = ()

    @property
    def by_record(self) -> list[tuple[NormalEquations, Point]]:
        """Of every record its equations, and the point where they are solved."""
        equations = self.evidence.equations
        return list(zip(equations.each, equations.split(self.trained.solution.point), strict=True))


@dataclass(frozen=True)
class InferenceSettings:
    """How a problem is solved; see :class:`pinn_cli.training.gauss_newton.GaussNewton`.

    Attributes:
        known: Parameters that are told before, and held.
    """

    iterations: int
    tolerance: float
    learn_spread: bool
    pooled: bool
    known: KnownParameters | None = None

    def solved_by(self, problem: Problem, networks: Sequence[LinearReadout], device: str, history: History) -> Evidence:
        """What finds the solutions of one network for every record."""
        pairs = zip(problem.by_record, networks, strict=True)
        each = [NormalEquations(network, own, device, self.known) for own, network in pairs]
        return Evidence(each, self.iterations, self.tolerance, history.add_step, self.learn_spread, history.count)
