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


class LeastSquares(Protocol):
    """A weighted least-squares problem: of one record, or of several together."""

    is_plain: bool

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
        factor: Undamped factors of the Hessian from which that last, negligible step was taken; None where it did not
            converge.
    """

    point: Point
    loss: float
    iterations: int
    converged: bool
    factor: BorderedFactor | None = None


def minimise(
    equations: LeastSquares,
    noise: NoiseModel,
    start: Point,
    iterations: int,
    tolerance: float,
    watch: Callable[[dict[str, float]], None],
) -> Solution:
    """Levenberg-Marquardt from a starting point.

    A step is taken when the loss does not rise, if need be after the motion has followed the parameters
    (:func:`followed`); otherwise the damping grows tenfold. After an accepted step it falls
    tenfold, and to zero once it is negligible, which gives back Gauss-Newton's quadratic convergence.

    Args:
        equations: The least-squares problem.
        noise: Its weights.
        start: Where to begin.
        iterations: Steps at most.
        tolerance: Relative decrease of the loss below which it has converged.
        watch: Called with every loss term after each accepted step.

    Raises:
        DivergenceError: The loss is not finite at the start.
    """
    point, damping = start, 0.0
    loss = sum(equations.losses(point, noise).values())
    if not math.isfinite(loss):
        raise DivergenceError(
            "the loss is not finite at the start of Gauss-Newton; look for extreme values in the record or parameters"
        )
    for iteration in range(iterations):
        system = equations.assemble(point, noise)
        while True:
            factor = system.factor(damping)
            if factor is not None:
                moved = equations.moved(point, factor.step(system, equations.room_below(point)))
                terms = equations.losses(moved, noise)
                if sum(terms.values()) <= loss * (1.0 + 1e-12):
                    break
                moved = followed(equations, moved, noise)
                terms = equations.losses(moved, noise)
                if sum(terms.values()) <= loss * (1.0 + 1e-12):
                    break
            damping = max(10.0 * damping, FIRST_DAMPING)
            if damping > LARGEST_DAMPING:
                return Solution(point, loss, iteration, False)
        undamped, decrease = damping == 0.0, loss - sum(terms.values())
        point, loss = moved, sum(terms.values())
        damping = damping / 10.0 if damping > FIRST_DAMPING else 0.0
        watch(terms)
        enough = max(tolerance * loss, 0.0 if equations.is_plain else NEGLIGIBLE)
        if decrease <= enough and damping == 0.0:
            return Solution(point, loss, iteration + 1, True, factor if undamped else None)
    return Solution(point, loss, iterations, False)


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
