"""Whether a record says of a structure what the records before it said, and what has changed if it does not.

With C the covariance that earlier records leave, J the information of the new record and d how far it pulls the
parameters by itself, d has the covariance V = C + J^-1 if nothing changed. J may be singular, so all is written with
V^-1 = (1 + J C)^-1 J and V^-1 d = (1 + J C)^-1 J d. If parameter j alone changed, its most probable change is
(V^-1 d)_j / (V^-1)_jj with the variance 1 / (V^-1)_jj, and the square of their ratio is chi-square distributed where
nothing changed. The largest of p such squares is by chance what p of them make of it (Bonferroni).

What the model leaves out hides a part of each parameter, in the old records and in the new one. Both are in C.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from pinn_cli.model.knowledge import ParameterKnowledge
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.quantities import CALIBRATION_UNITS
from pinn_cli.training.estimate import Change, Changes, Estimate, RunContext
from pinn_cli.training.estimator import TrainedNetwork
from pinn_cli.training.noise_model import updated_spread
from pinn_cli.training.record_scales import force_and_velocity_scale

# Probability of a false alarm per record.
IMPROBABLE = 1e-3
# Information over that of the earlier records from which on a record tells a direction of the parameters.
TELLS = 1e-6


def found_changes(problem: Problem, known: ParameterKnowledge, solved: Problem | None = None) -> Changes:
    """What a record says against the prior of its problem.

    Args:
        problem: With the prior of earlier records.
        known: What all records together say under the prior of ``solved``.
        solved: The problem with some parameters :func:`released`; None: as it is. Where a change is large, what the
            record says is right near the parameters as they are now.
    """
    prior, uncertain, solved = problem.prior, problem.uncertain, solved or problem
    assert prior is not None
    assert solved.prior is not None
    before, unit = _earlier(problem), np.array([p.prior_std for p in uncertain])
    ratio = unit / np.array([p.prior_std for p in solved.uncertain])
    together = np.linalg.inv(known.covariance / np.outer(unit, unit))
    told = together - solved.prior.precision * np.outer(ratio, ratio)
    values, vectors = np.linalg.eigh((told + told.T) / 2.0)
    information = (vectors * values.clip(min=0.0)) @ vectors.T  # what rounding has made negative says nothing
    pull = together @ ((known.mean - before.mean) / unit)
    covariance = prior.correlation + np.diag((before.hidden**2 + known.hidden**2) / unit**2)
    comparison = _Comparison(problem, information, pull, covariance)
    changed = comparison.changes()
    chance = _as_a_whole(information, pull, comparison.opened(uncertain.index(change.parameter) for change in changed))
    alone, alone_std = _by_itself(information, pull)
    before_std, hidden = np.sqrt(unit**2 + before.hidden**2), np.hypot(unit * alone_std, known.hidden)
    return Changes(uncertain, changed, chance, IMPROBABLE, before.mean, before_std, before.mean + unit * alone, hidden)


@dataclass(frozen=True, eq=False)
class _Comparison:
    """A record against those before it; see the module, in prior standard deviations.

    Attributes:
        problem: With the prior of earlier records.
        information: J (p, p).
        pull: J d (p,).
        covariance: C (p, p).
    """

    problem: Problem
    information: np.ndarray
    pull: np.ndarray
    covariance: np.ndarray

    def changes(self) -> tuple[Change, ...]:
        """One change after the other, the most certain one first, until what is left is chance; sized together."""
        candidates = [i for i, p in enumerate(self.problem.uncertain) if p.kind not in CALIBRATION_UNITS]
        count, moved = len(candidates), dict[int, tuple[float, float]]()
        while candidates:
            score, variance = self._against(moved)
            square = np.divide(score**2, variance, out=np.zeros(len(score)), where=variance > TELLS)
            j = max(candidates, key=lambda i: square[i])
            chance = min(1.0, count * float(chdtrc(1, square[j])))
            if not chance < IMPROBABLE:
                break
            moved[j] = chance, float(1.0 / np.exp(0.5 * (square[candidates] - square[j])).sum())
            candidates.remove(j)
        return tuple(self._sized(j, [i for i in moved if i != j], *certainty) for j, certainty in moved.items())

    def _sized(self, j: int, others: Sequence[int], chance: float, share: float) -> Change:
        """The change of a parameter, the others that changed left open."""
        score, variance = self._against(others)
        parameter = self.problem.uncertain[j]
        by, std = score[j] / variance[j], 1.0 / np.sqrt(variance[j])
        return Change(parameter, float(parameter.prior_std * by), float(parameter.prior_std * std), chance, share)

    def opened(self, changed: Iterable[int]) -> np.ndarray:
        """C (p, p) where these parameters may have become anything."""
        out = self.covariance.copy()
        for j in changed:
            out[j, j] += (_open(self.problem, j) / self.problem.uncertain[j].prior_std) ** 2
        return out

    def _against(self, changed: Iterable[int]) -> tuple[np.ndarray, np.ndarray]:
        """V^-1 d (p,) and the diagonal of V^-1 (p,) where these parameters may have become anything."""
        right = np.column_stack((self.pull, self.information))
        solved = np.linalg.solve(np.eye(len(self.pull)) + self.information @ self.opened(changed), right)
        return solved[:, 0], np.diag(solved[:, 1:])


def released(problem: Problem, changed: Collection[Parameter]) -> Problem:
    """The problem with parameters that changed left open: earlier records say nothing of what they are now."""
    known = _earlier(problem)
    covariance = known.covariance.copy()  # below, squares of an array are rounded in another way
    for parameter in changed:
        j = problem.uncertain.index(parameter)
        covariance[j, j] += _open(problem, j) ** 2
    return _knowing(problem, replace(left_open(known, problem, changed), covariance=covariance))


def left_open(known: ParameterKnowledge, problem: Problem, changed: Collection[Parameter]) -> ParameterKnowledge:
    """What a window hands over of its parameters, those that changed left open.

    When in the window they changed is not known: what it says of them lies between what they were and what they are,
    and the next window would find the rest of the change a second time.
    """
    places = [problem.uncertain.index(parameter) for parameter in changed]
    size = np.array([_open(problem, j) for j in places])
    covariance, told, weight, first = (
        values.copy() for values in (known.covariance, known.told, known.weight, known.first_std)
    )
    covariance[places, places] += size**2
    told[places] = weight[places] = 0.0
    first[places] = np.maximum(first[places], size)
    prescribed = None if known.prescribed is None else known.prescribed.copy()
    if prescribed is not None:
        prescribed[places] = np.nan
    return replace(known, covariance=covariance, told=told, weight=weight, first_std=first, prescribed=prescribed)


def _earlier(problem: Problem) -> ParameterKnowledge:
    """What the records before say, about the values that bounds leave of the parameters."""
    assert problem.prior is not None
    mean, std = (np.array([getattr(p, name) for p in problem.uncertain]) for name in ("prescribed", "prior_std"))
    return replace(problem.prior, mean=mean, covariance=problem.prior.correlation * np.outer(std, std))


def _knowing(problem: Problem, known: ParameterKnowledge) -> Problem:
    """The problem of an update whose earlier records say this; its structure stays."""
    uncertain = tuple(
        replace(p, prescribed=max(float(m), 0.0) if p.positive else float(m), prior_std=float(s))
        for p, m, s in zip(problem.uncertain, known.mean, known.std, strict=True)
    )
    return replace(problem, uncertain=uncertain, prior=known)


def _open(problem: Problem, j: int) -> float:
    """Standard deviation of a parameter that may have become anything: its own size, or what was believed at first."""
    assert problem.prior is not None
    return max(abs(problem.uncertain[j].prescribed), float(problem.prior.first_std[j]))


def _as_a_whole(information: np.ndarray, pull: np.ndarray, covariance: np.ndarray) -> float:
    """Probability that d' V^-1 d is as large by chance, in the directions that the record tells."""
    values, vectors = np.linalg.eigh(information)
    kept = values > TELLS
    along = vectors[:, kept].T @ pull / values[kept]
    inside = vectors[:, kept].T @ covariance @ vectors[:, kept] + np.diag(1.0 / values[kept])
    return float(chdtrc(int(kept.sum()), float(along @ np.linalg.solve(inside, along)))) if kept.any() else 1.0


def _by_itself(information: np.ndarray, pull: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Estimate and standard deviation of every parameter by the record alone; NaN where it cannot tell one."""
    unknown = np.full(len(pull), np.nan)
    try:
        root = np.linalg.inv(np.linalg.cholesky(information))
    except np.linalg.LinAlgError:
        return unknown, unknown
    covariance = root.T @ root
    return covariance @ pull, np.sqrt(np.diag(covariance))


# Rounds at most, and the relative change below which a spread has settled.
SPREAD_ROUNDS, SPREAD_SETTLED = 200, 1e-4
# Solutions at most until the changes that one finds are those that it was solved with.
SOLUTIONS = 3
# Of the force that acts, what a model leaves out from which on a record hardly tells that a parameter changed.
HARDLY_TELLS = 0.1
# Relative change of what prescribed parameters are off in common from which on it is worth another solution.
WORTH_ANOTHER = 0.05


def common_spread(known: ParameterKnowledge) -> float:
    """The common spread that is most probable after all records; as it is where no parameter shares one."""
    sharing = known.sharing
    if not sharing.any():
        return known.spread
    assert known.prescribed is not None
    for _ in range(SPREAD_ROUNDS):
        off = ((known.mean - known.prescribed) / known.first_std)[sharing]
        variance = (np.diag(known.covariance) / known.first_std**2)[sharing]
        spread = updated_spread(off, variance, known.spread)
        if abs(spread / known.spread - 1.0) < SPREAD_SETTLED:
            break
        known = known.with_spread(spread)
    return known.spread


def under_spread(problem: Problem, spread: float) -> Problem:
    """The problem of an update whose earlier records are looked at again under another common spread."""
    again, structure = _knowing(problem, _earlier(problem).with_spread(spread)), problem.structure
    values = {p: p.prescribed for p in again.uncertain if p.kind in structure.parameters}
    return replace(again, structure=structure.with_values(values))


@dataclass(frozen=True)
class UpdatedNetwork(TrainedNetwork):
    """A network whose problem's prior is what earlier records say."""

    def solve(self, problem: JointProblem, run: RunContext) -> Estimate:
        """See :meth:`Estimator.solve`; where something changed, again with it left open.

        A parameter that changed much is pulled by the others' prior as well: only a solution with it left open says by
        how much it changed, and whether another one did. What the record tells is little where much is left out, as it
        is where the prior is far off: then all are left open at first.
        """
        if not problem.is_informed:
            return super().solve(problem, run)
        alone, held = self._under_their_spread(problem.alone, run)
        estimate, changes, opened = held, None, list[Parameter]()
        if held.noise.discrepancy > HARDLY_TELLS * force_and_velocity_scale(alone)[0]:
            opened = [p for p in alone.uncertain if p.kind not in CALIBRATION_UNITS]
        for _ in range(SOLUTIONS):
            solved = released(alone, opened) if opened else alone
            estimate = super().solve(JointProblem.of(solved), run) if opened else held
            if estimate.known is None:
                return estimate
            changes = found_changes(alone, estimate.known, solved)
            before, opened = {p.name for p in opened}, [change.parameter for change in changes.found]
            if {p.name for p in opened} == before:
                break
        handed = estimate.handed_over
        if handed is not None:
            handed = replace(handed, known=left_open(handed.known, alone, opened))
        return replace(estimate, changes=changes, handed_over=handed)

    def _under_their_spread(self, problem: Problem, run: RunContext) -> tuple[Problem, Estimate]:
        """The problem and its solution under the common spread that all records together ask for."""
        estimate = super().solve(JointProblem.of(problem), run)
        if estimate.known is None or problem.prior is None or problem.initial_state is not None:
            return problem, estimate  # a state that is handed over goes with what was handed over of the parameters
        spread = common_spread(estimate.known)
        if abs(np.log(spread / problem.prior.spread)) < WORTH_ANOTHER:
            return problem, estimate
        problem = under_spread(problem, spread)
        return problem, super().solve(JointProblem.of(problem), run)
