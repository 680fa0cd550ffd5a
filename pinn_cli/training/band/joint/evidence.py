"""How probable several records of one structure are under the noise models of each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from pinn_cli.runs.side_by_side import side_by_side
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.band.bordered import BorderedFactor
from pinn_cli.training.band.discrepancy_search import DiscrepancySearch, Trained
from pinn_cli.training.band.evidence import Evidence, parameter_term
from pinn_cli.training.band.joint import member
from pinn_cli.training.band.joint.equations import JointEquations, JointFactor
from pinn_cli.training.band.joint.member import Member, PartKey
from pinn_cli.training.band.point import Point
from pinn_cli.training.noise_model import NoiseModel

R = TypeVar("R")


class JointEvidence(DiscrepancySearch):
    """The sum over the records of what each says of its motion, and once what all of them say of the parameters.

    Args:
        problem: Of all records.
        records: The evidence of each, with the same settings.

    Attributes:
        equations: Of all records.
    """

    def __init__(self, problem: Problem, records: Sequence[Evidence]) -> None:
        first = records[0]
        each = [own.equations for own in records]
        on_cpu = all(equations.target.force.device.type == "cpu" for equations in each)
        sizes = [equations.layout.size for equations in each]
        equations = JointEquations(each, side_by_side([Member(own) for own in records], sizes, copied=on_cpu))
        super().__init__(equations, first.iterations, first.tolerance, first.watch, first.learn_spread, first.count)
        self.equations, self.problem, self.records = equations, problem, tuple(records)

    @property
    def unknown(self) -> np.ndarray:
        """See :attr:`DiscrepancySearch.unknown`."""
        return self.equations.unknown.numpy()

    def log_evidence(self, point: Point, noise: NoiseModel, factor: BorderedFactor) -> float:
        """See :meth:`DiscrepancySearch.log_evidence`."""
        assert isinstance(factor, JointFactor)
        each = self.equations.members.each(
            member.record_term, self.equations.places(point), noise.by_record, factor.determinants
        )
        return sum(each) + parameter_term(self.unknown, point, noise, factor, self.prior_pull(point, noise))

    def prior_pull(self, point: Point, noise: NoiseModel) -> np.ndarray:
        """See :meth:`Evidence.prior_pull`."""
        pull: np.ndarray = self.equations.precision(noise).cpu().numpy() * point.parameters.cpu().numpy()
        return pull

    def occupied(self, trained: Trained) -> list[float]:
        """See :meth:`DiscrepancySearch.occupied`."""
        return self.equations.members.each(member.occupied, self._parts(trained))

    def each_record(self, function: Callable[..., R], trained: Trained, *arguments: Sequence[Any]) -> list[R]:
        """See :meth:`DiscrepancySearch.each_record`."""
        functions = [function] * len(self.records)
        return self.equations.members.each(member.applied, functions, self._parts(trained), *arguments)

    def _parts(self, trained: Trained) -> list[PartKey]:
        factor, solution = trained.factor, trained.solution
        assert isinstance(factor, JointFactor)
        places, bare = self.equations.places(solution.point), replace(solution, point=None, factor=None)  # type: ignore[arg-type]
        return [
            PartKey(place, level, factor.keys[i], factor.of_record(i), bare, trained.log_evidence)
            for i, (place, level) in enumerate(zip(places, trained.noise.by_record, strict=True))
        ]
