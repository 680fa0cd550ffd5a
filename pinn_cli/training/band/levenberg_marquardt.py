"""Damped Gauss-Newton for one noise model."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from pinn_cli.settings.errors import DivergenceError
from pinn_cli.training.band.bordered import BorderedFactor
from pinn_cli.training.band.point import Point
from pinn_cli.training.noise_model import NoiseModel

# Damping of the scaled matrix (unit diagonal): where it starts once a step has failed, and where trying is given up.
FIRST_DAMPING, LARGEST_DAMPING = 1e-9, 1e6
# Decrease of the loss, twice the negative logarithm of a probability, that nothing is lost by leaving out. Functions
# beside the motion are known in parts by their priors alone, along which steps creep.
NEGLIGIBLE = 0.1


class Linearised(Protocol):
    """Normal equations at a point."""

    def factor(self, damping: float = 0.0) -> BorderedFactor | None:
        """Of the damped matrix; None if it is not positive definite."""

    def readout_step(self) -> np.ndarray | None:
        """Of the readout weights, with the parameters held; None if their matrix is not positive definite."""

    def decrease(self, step: tuple[np.ndarray, np.ndarray]) -> float:
        """Of the loss, by the undamped, unbounded step, as the linearised problem has it."""


class LeastSquares(Protocol):
    """A weighted least-squares problem: of one record, or of several together."""

    is_plain: bool
    is_linear: bool

    def start(self) -> Point:
        """At rest, with the prescribed parameters."""

    def losses(self, point: Point, noise: NoiseModel) -> dict[str, float]:
        """Weighted sum of squares of every term."""

    def assemble(self, point: Point, noise: NoiseModel) -> Any:  # each kind's factor takes a step of its own system
        """Normal equations at a point, :class:`Linearised`."""

    def room_below(self, point: Point) -> np.ndarray:
        """(p,), the most negative step of every parameter."""

    def moved(self, point: Point, step: tuple[np.ndarray, np.ndarray]) -> Point:
        """The point after a step."""


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
        cautious: Whether the last undamped step was refused.
    """

    point: Point
    loss: float
    iterations: int
    converged: bool
    factorisations: int
    factor: BorderedFactor | None = None
    cautious: bool = False


def minimise(
    equations: LeastSquares,
    noise: NoiseModel,
    start: Point,
    iterations: int,
    tolerance: float,
    watch: Callable[[dict[str, float]], None],
    cautious: bool = False,
) -> Solution:
    """Levenberg-Marquardt from a starting point.

    A step is taken when the loss does not rise, if need be after the motion has followed the parameters
    (:func:`followed`); otherwise the damping grows tenfold. After an accepted step it falls
    tenfold, and to zero once it is negligible, which gives back Gauss-Newton's quadratic convergence.

    Where little is known of a distant part of a structure, whole steps go far along directions that change the loss by
    next to nothing, out of the range of the linearisation. A whole step that promises no more than the tolerance is the
    end, whatever comes of it. Where the last whole step was refused, the first one is damped and no other is followed.

    Args:
        equations: The least-squares problem.
        noise: Its weights.
        start: Where to begin.
        iterations: Steps at most.
        tolerance: Relative decrease of the loss below which it has converged.
        watch: Called with every loss term after each accepted step.
        cautious: Whether the last undamped step of a similar problem was refused.

    Raises:
        DivergenceError: The loss is not finite at the start.
    """
    point, damping, tries = start, FIRST_DAMPING if cautious else 0.0, 0
    loss = sum(equations.losses(point, noise).values())
    if not math.isfinite(loss):
        raise DivergenceError(
            "the loss is not finite at the start of Gauss-Newton; look for extreme values in the record or parameters"
        )
    for iteration in range(iterations):
        system, room = equations.assemble(point, noise), equations.room_below(point)
        undamped, tried = None, damping == 0.0
        enough = max(tolerance * loss, 0.0 if equations.is_plain else NEGLIGIBLE)
        while True:
            factor, tries = system.factor(damping), tries + 1
            undamped = factor if damping == 0.0 else undamped
            if factor is not None:
                step = factor.step(system, room)
                moved = equations.moved(point, step)
                terms = equations.losses(moved, noise)
                if sum(terms.values()) <= loss * (1.0 + 1e-12):
                    break
                if damping == 0.0 and np.all(step[1] > room) and system.decrease(step) <= enough:
                    return Solution(point, loss, iteration, True, tries, factor, cautious)
                if damping > 0.0 or not cautious:
                    moved, tries = followed(equations, moved, noise), tries + 1
                    terms = equations.losses(moved, noise)
                    if sum(terms.values()) <= loss * (1.0 + 1e-12):
                        break
            cautious = cautious or damping == 0.0
            damping = max(10.0 * damping, FIRST_DAMPING)
            if damping > LARGEST_DAMPING:
                return Solution(point, loss, iteration, False, tries, cautious=cautious)
        decrease, damped = loss - sum(terms.values()), damping > 0.0
        damping = damping / 10.0 if damping > FIRST_DAMPING else 0.0
        converged = decrease <= enough and damping == 0.0 and tried
        if converged and damped and undamped is not None:
            # A damped step that gains next to nothing may go far all the same: the Hessian belongs to where it began.
            return Solution(point, loss, iteration, True, tries, undamped, cautious)
        point, loss, cautious = moved, sum(terms.values()), cautious and damped
        watch(terms)
        if converged or (equations.is_linear and factor is undamped):
            return Solution(point, loss, iteration + 1, True, tries, undamped, cautious)
        del system, factor, undamped, step  # before the next are made
    return Solution(point, loss, iterations, False, tries, cautious=cautious)


def followed(equations: LeastSquares, point: Point, noise: NoiseModel) -> Point:
    """The point whose motion has made a step of its own, parameters held.

    Where physics is stiff, a step of motion and parameters together leaves the narrow valley of what solves it by the
    product of both changes. The motion is (nearly) linear given the parameters: one step brings it back (variable
    projection; Golub and Pereyra 1973).
    """
    if not len(point.parameters):
        return point
    step = equations.assemble(point, noise).readout_step()
    return point if step is None else equations.moved(point, (step, np.zeros(len(point.parameters))))
