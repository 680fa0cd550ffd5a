"""Damped Gauss-Newton for one noise model."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from torch import Tensor

from pinn_cli.settings.errors import DivergenceError
from pinn_cli.training.noise_model import NoiseLevels
from pinn_cli.training.normal_matrix.bordered import SharedFactor

# Damping of the scaled matrix (unit diagonal): where it starts once a step has failed, and where trying is given up.
FIRST_DAMPING, LARGEST_DAMPING = 1e-9, 1e6
# Decrease of the loss, twice the negative logarithm of a probability, that nothing is lost by leaving out. Functions
# beside the motion are known in parts by their priors alone, along which steps creep.
NEGLIGIBLE_LOSS = 0.1
# A step with the factor of another one is quick if it promises so much of what the step before promised, and good if it
# keeps so much of its promise.
QUICK, KEPT_PROMISE = 0.1, 0.5
# Relative rise of the loss that may be rounding.
ROUNDING = 1e-12


class System(Protocol):
    """A least-squares problem linearised at a point."""

    def factor(self, damping: float) -> Any:
        """What has the ``step`` of a system, with so much damping; None where it is not positive definite."""

    def decrease(self, step: Any) -> float:
        """What the system's own step takes off its loss."""


class Equations(Protocol):
    """A weighted least-squares problem: :class:`pinn_cli.training.least_squares.LeastSquares`, or that of a network."""

    @property
    def is_plain(self) -> bool:
        """Whether the motion is all that is unknown beside the parameters."""

    @property
    def is_linear(self) -> bool:
        """Whether one step solves it."""

    def losses(self, point: Point, noise: NoiseLevels) -> dict[str, float]:
        """What adds up to the loss."""

    def assemble(self, point: Point, noise: NoiseLevels) -> System:
        """The system of a step."""

    def room_below(self, point: Point) -> np.ndarray:
        """(p,), the most negative step of every parameter that respects its bound."""

    def moved(self, point: Point, step: Any) -> Point:
        """The point after a step."""

    def retries(self, start: Point, refused: Point, noise: NoiseLevels) -> Iterator[Point]:
        """Where a step from ``start`` may end instead, whose loss rises where it ends."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Where an optimisation ended.

    Attributes:
        point: The best point found.
        loss: Weighted sum of squares there.
        iterations: Accepted steps.
        converged: Whether the last step changed the loss by less than the tolerance.
        factor: Undamped factors of the Hessian where that last, negligible step began; None where it did not converge,
            or where the Hessian is not positive definite.
        factorisations: That were tried.
        damping: That the next step would have; 0 where the last undamped step was not refused.
        chord: The factor that the last step was made with.
    """

    point: Point
    loss: float
    iterations: int
    converged: bool
    factorisations: int
    factor: SharedFactor | None = None
    damping: float = 0.0
    chord: SharedFactor | None = None

    @property
    def fruitless(self) -> int:
        """Factorisations that led to no step of their own, at least."""
        return self.factorisations - self.iterations


def minimise(
    equations: Equations,
    noise: NoiseLevels,
    start: Point,
    iterations: int,
    tolerance: float,
    watch: Callable[[dict[str, float]], None],
    damping: float = 0.0,
    near: SharedFactor | None = None,
) -> Solution:
    """Levenberg-Marquardt from a starting point.

    A step is taken when the loss does not rise, if need be after the motion has followed the parameters
    (:meth:`Equations.retries`); otherwise the damping grows tenfold. After a step that is accepted at once it falls
    tenfold, and to zero once it is negligible, which gives back Gauss-Newton's quadratic convergence.

    A factor serves further steps for as long as each promises a tenth of the one before and keeps half of its promise
    (the chord method; Kelley 1995, section 5.4): near a solution, that is until it is reached. Damped steps that creep
    are no quicker with a factor of their own; where that shows, one serves them all. The Hessian of the solution has
    the last factor.

    Where little is known of a distant part of a structure, whole steps go far along directions that change the loss by
    next to nothing, out of the range of the linearisation. A whole step that promises no more than the tolerance is the
    end, whatever comes of it. Where the last whole step was refused, the first one is damped and no other is followed.

    Args:
        equations: The least-squares problem.
        noise: Its weights.
        start: Where to begin.
        iterations: Steps with a factor of their own at most, and steps that any one factor serves further.
        tolerance: Relative decrease of the loss below which it has converged.
        watch: Called with every loss term after each accepted step.
        damping: Of the next step of a similar problem; 0 where its last undamped step was not refused.
        near: A factor of a Hessian that differs little, damped where that was of use; None: there is none.

    Raises:
        DivergenceError: The loss is not finite at the start.
    """
    descent = Descent(equations, noise, start, tolerance, watch, damping, near)
    for _ in range(iterations):
        solution = descent.advance(iterations)
        if solution is not None:
            return solution
    return descent.ended(False)


class Descent:
    """A solution on its way, see :func:`minimise`.

    Attributes:
        point, loss, steps: Where it is, and how many steps were accepted.
        damping: Of the next step.
        chord: The factor that the last step was made with.
        promised: What that step promised to take off the loss.
    """

    def __init__(
        self,
        equations: Equations,
        noise: NoiseLevels,
        start: Point,
        tolerance: float,
        watch: Callable[[dict[str, float]], None],
        damping: float = 0.0,
        near: SharedFactor | None = None,
    ) -> None:
        self.equations, self.noise, self.tolerance, self.watch = equations, noise, tolerance, watch
        self.point, self.cautious, self.damping = start, damping > 0.0, damping
        self.steps = self.factorisations = 0
        self.chord: Any = near
        self.promised = math.inf
        self.refused = 0.0  # what a step with the last factor promised where another one was made
        self.creeps = False  # whether that other one promised as little: no factor makes the rest of the way quick
        # The ridge hangs on the first system, and counts from there on: so the loss comes after it.
        self.first: tuple[System, np.ndarray] | None = self._assembled()
        self.loss = sum(equations.losses(start, noise).values())
        if not math.isfinite(self.loss):
            raise DivergenceError(
                "the loss is not finite at the start of Gauss-Newton; look for extreme values in the record or "
                "parameters"
            )

    @property
    def enough(self) -> float:
        """Decrease of the loss that another step is not worth."""
        return max(self.tolerance * self.loss, 0.0 if self.equations.is_plain else NEGLIGIBLE_LOSS)

    def ended(self, converged: bool, factor: SharedFactor | None = None) -> Solution:
        """The solution as it stands, with the undamped factor of its Hessian."""
        kept = self.damping if FIRST_DAMPING <= self.damping <= LARGEST_DAMPING else FIRST_DAMPING
        damping = kept if self.cautious else 0.0
        return Solution(self.point, self.loss, self.steps, converged, self.factorisations, factor, damping, self.chord)

    def advance(self, most: int) -> Solution | None:
        """At most so many steps with the last factor while they are quick, then one with its own; the end, if it is."""
        system, room = self.first or self._assembled()
        self.first, served = None, 0
        while self.chord is not None and served < most:
            trial = self._trial(system, self.chord, room)
            if max(trial.promised, trial.gain) <= self.enough:
                return self._settled(system, room)
            self.refused = trial.promised
            if not (
                trial.gain >= KEPT_PROMISE * trial.promised and (self.creeps or trial.promised <= QUICK * self.promised)
            ):
                break
            self._accept(trial)
            served += 1
            system, room = self._assembled()
        return self._factored(system, room)

    def _settled(self, system: System, room: np.ndarray) -> Solution | None:
        """The end, with the Hessian there; None where its own whole step gains more after all."""
        factor = self._factor(system, 0.0)
        if factor is None:
            return self.ended(True)
        trial = self._trial(system, factor, room)
        if self._falls(trial):
            enough = self.enough
            self._accept(trial)
            self.chord, self.cautious, self.damping = factor, False, 0.0
            return self.ended(True, factor) if trial.gain <= enough or self.equations.is_linear else None
        if self.cautious or trial.promised <= self.enough:
            return self.ended(True, factor)
        self.chord, self.damping = None, 0.0  # whole steps are refused here: with care from here on
        return None

    def _factored(self, system: System, room: np.ndarray) -> Solution | None:
        """A step with a factor of its own, as little damped as can be; the end, if it is."""
        undamped, tried, first = None, False, self.damping
        while True:
            factor = self._factor(system, self.damping)
            if self.damping == 0.0:
                undamped, tried = factor, True
            if factor is not None:
                trial = self._trial(system, factor, room)
                if self._falls(trial):
                    break
                free = np.all(trial.step[1] > room)
                if self.damping == 0.0 and free and trial.promised <= self.enough:
                    self.chord = factor
                    return self.ended(True, factor)
                if math.isfinite(trial.gain) and (self.damping > 0.0 or not self.cautious):
                    trial = self._retried(trial)
                    if self._falls(trial):
                        break
            self.cautious = self.cautious or self.damping == 0.0
            self.damping = max(10.0 * self.damping, FIRST_DAMPING)
            if self.damping > LARGEST_DAMPING:
                return self.ended(False)
        self.chord = factor
        negligible = trial.gain <= self.enough and self.damping <= FIRST_DAMPING
        if self.damping == 0.0:
            # Whole steps that promise more and more of the same go back and forth along what is hardly known.
            self.cautious = not negligible and trial.promised > QUICK * self.promised
            self.damping = FIRST_DAMPING if self.cautious else 0.0
            self._accept(trial)
            return self.ended(True, undamped) if negligible or self.equations.is_linear else None
        if negligible:
            # A damped step that gains next to nothing may go far all the same: the Hessian belongs to where it began.
            return self.ended(True, undamped) if tried else self._settled(system, room)
        self._accept(trial)
        self.creeps = trial.promised <= 2.0 * self.refused
        if self.damping == first:
            self.damping = max(self.damping / 10.0, FIRST_DAMPING)
        return None

    def _assembled(self) -> tuple[System, np.ndarray]:
        return self.equations.assemble(self.point, self.noise), self.equations.room_below(self.point)

    def _factor(self, system: System, damping: float) -> Any:
        self.factorisations += 1
        return system.factor(damping)

    def _trial(self, system: System, factor: Any, room: np.ndarray) -> _Trial:
        step = factor.step(system, room)
        moved = self.equations.moved(self.point, step)
        terms = self.equations.losses(moved, self.noise)
        return _Trial(step, moved, terms, system.decrease(step), self.loss - sum(terms.values()))

    def _retried(self, trial: _Trial) -> _Trial:
        """The first retry that lowers the loss, or the last one."""
        for moved in self.equations.retries(self.point, trial.moved, self.noise):
            self.factorisations += 1
            terms = self.equations.losses(moved, self.noise)
            trial = replace(trial, moved=moved, terms=terms, gain=self.loss - sum(terms.values()))
            if self._falls(trial):
                break
        return trial

    def _falls(self, trial: _Trial) -> bool:
        """Whether the loss does not rise, but for rounding."""
        return trial.gain >= -ROUNDING * self.loss

    def _accept(self, trial: _Trial) -> None:
        self.point, self.promised = trial.moved, trial.promised
        self.loss = sum(trial.terms.values())
        self.steps += 1
        self.watch(trial.terms)


@dataclass(frozen=True, eq=False)
class _Trial:
    """A step that may be taken.

    Attributes:
        step: Of weights and parameters.
        moved: Where it ends.
        terms: Of the loss there.
        promised: Decrease of the loss, as the linearised problem has it.
        gain: Decrease of the loss.
    """

    step: tuple[Any, np.ndarray]
    moved: Point
    terms: dict[str, float]
    promised: float
    gain: float


@dataclass(frozen=True, eq=False)
class Point:
    """Where Gauss-Newton stands.

    Attributes:
        unknowns: (size,) readout weights in the layout's order; of several records one after the other.
        parameters: (p,) uncertain parameters, in prior standard deviations from their prescribed values.
    """

    unknowns: Tensor
    parameters: Tensor

    @property
    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """Both, as they are sent to where a record is."""
        return self.unknowns.numpy(), self.parameters.numpy()

    def moved(self, step: tuple[Tensor, Tensor]) -> Point:
        """The point after a step."""
        return Point(self.unknowns + step[0], self.parameters + step[1])

    def beside(self, i: int, width: float) -> tuple[Point, Point]:
        """With a parameter so much more, and so much less, in prior standard deviations."""
        shift = self.parameters.new_zeros(self.parameters.shape)
        shift[i] = width
        return replace(self, parameters=self.parameters + shift), replace(self, parameters=self.parameters - shift)
