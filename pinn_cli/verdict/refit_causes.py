"""Causes where stiffnesses are unknown, so that neither the prescribed chain nor a misled estimate can tell them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.channels import channels
from pinn_cli.verdict.chain_faults import UNITS, mass_finding, unit_finding
from pinn_cli.verdict.channel_faults import channel_faults, swap_finding
from pinn_cli.verdict.comparison import comparisons, worst_misfit
from pinn_cli.verdict.prediction import is_linear, predicted
from pinn_cli.verdict.refit import refitted

if TYPE_CHECKING:
    from pinn_cli.record.record import Record
    from pinn_cli.scheme.problem import Problem
    from pinn_cli.system.parameters import Parameter
    from pinn_cli.system.structure import Structure
    from pinn_cli.verdict.finding import Finding

# Free stiffnesses can make up for much: a cause must leave less than where the structure is prescribed, and this many
# times less than the fit without it; a gain 15 % off leaves 0.02 where two channels disagree.
LEFT, BETTER, GAIN_BETTER = 0.05, 4.0, 1.5
# Pairs of sensors that are tried in each other's place, a second each.
MOST_PAIRS = 10
LEAST_FACTOR = 1.3


def refit_causes(problem: Problem, excused: Sequence[str]) -> list[Finding]:
    """The one channel, mass or unit of time without which a structure with free stiffnesses does what was measured.

    Args:
        problem: Some of whose stiffnesses are unknown; without any there is nothing to refit. A nonlinear chain's
            spectra are not those of a linear one, and masses would be blamed for the difference.
        excused: Names of channels whose fault is known already.
    """
    free = [parameter for parameter in problem.uncertain if parameter.unknown and parameter.kind == "k"]
    if not free or not is_linear(problem.structure) or not np.isfinite(problem.record.force).all():
        return []
    # Spectra are compared with those of forces; a structure that is released has none.
    if problem.record.ground_acceleration is not None or problem.record.supports or not problem.record.force.any():
        return []
    return _Refits(problem.structure, problem.record, free, excused).causes()


@dataclass(frozen=True, eq=False)
class _Refits:
    """Fits of the structure's free stiffnesses to a record that is put right in one way or another."""

    structure: Structure
    record: Record
    free: Sequence[Parameter]
    excused: Sequence[str]

    def causes(self) -> list[Finding]:
        """The best cause, or none."""
        as_given = self.misfit(self.record)
        found = [self.channel(as_given)]
        if as_given > LEFT:
            found.append(self.time_unit(as_given))
            if found == [None, None]:
                found.append(self.exchanged(as_given))
            if found[1] is None and found[-1] is None and self.structure.shapes is None:
                found += [self.mass(dof, as_given) for dof in range(self.structure.ndof)]
        causes = [cause for cause in found if cause is not None]
        return [min(causes, key=lambda cause: cause.left)] if causes else []

    def fitted(self, record: Record, more: Sequence[Parameter] = (), levels: bool = True) -> Structure | None:
        """See `pinn_cli.verdict.refit.refitted`."""
        return refitted(self.structure, record, [*self.free, *more], self.excused, levels)

    def misfit(self, record: Record) -> float:
        """The largest NMSE of any channel of a record once the stiffnesses are fitted to it."""
        return self.misfit_of(self.fitted(record), record)

    def misfit_of(self, structure: Structure | None, record: Record) -> float:
        """The same of a structure; infinite without one."""
        return worst_misfit(None if structure is None else predicted(structure, record), self.excused)

    def channel(self, as_given: float) -> Finding | None:
        """The fault of one channel."""
        fitted = self.fitted(self.record, levels=False)
        prediction = None if fitted is None else predicted(fitted, self.record)
        faults = [] if prediction is None else channel_faults(prediction, self.excused)
        if prediction is None or len(faults) != 1:
            return None
        (fault,) = faults
        if fault.left > min(LEFT, as_given / GAIN_BETTER) or fault.kind == "sensor":
            return None
        others = [c.misfit for c in comparisons(prediction, self.excused) if c.channel.name not in fault.text]
        return None if fault.kind != "swap" and max(others, default=0.0) > LEFT else fault

    def time_unit(self, as_given: float) -> Finding | None:
        """The time axis in another unit."""
        for seconds in UNITS:
            left = self.misfit(replace(self.record, time=self.record.time * seconds))
            if left <= min(LEFT, as_given / BETTER):
                return unit_finding(seconds, left)
        return None

    def exchanged(self, as_given: float) -> Finding | None:
        """Two sensors of one kind, with the columns of which swapped the fit is better than with any others'."""
        pairs = combinations(channels(self.record, excused=self.excused), 2)
        alike = [(a, b) for a, b in pairs if a.quantity == b.quantity]
        best: Finding | None = None
        for a, b in alike if len(alike) <= MOST_PAIRS else []:
            values = getattr(self.record, a.quantity).copy()
            values[:, [a.dof, b.dof]] = values[:, [b.dof, a.dof]]
            left = self.misfit(replace(self.record, **{a.quantity: values}))
            if left <= min(LEFT, as_given / BETTER, best.left if best else np.inf):
                best = swap_finding(a, b, left)
        return best

    def mass(self, dof: int, as_given: float) -> Finding | None:
        """Another mass of a DOF, counted from 0."""
        fitted = self.fitted(self.record, [self.structure.parameter("m", dof)])
        left = self.misfit_of(fitted, self.record)
        if fitted is None or left > min(LEFT, as_given / BETTER):
            return None
        factor = float(fitted.parameters["m"][dof]) / float(self.structure.parameters["m"][dof])
        none = 1 / LEAST_FACTOR < factor < LEAST_FACTOR
        return None if none else mass_finding(self.structure, dof, factor, "a structure", left)
