"""The free run: what a structure does under the force of a record and the motion of its ground, left to itself.

No response sensor is looked at. What acts does between the samples what the record says
(:mod:`pinn_cli.record.between_samples`). A linear structure is followed exactly (:mod:`pinn_cli.record.linear_motion`),
another one in steps that are as many as its fastest motion needs, and implicit ones where these would be too many.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.between_samples import BandLimited, between_samples
from pinn_cli.record.linear_motion import Push, has_modes, linear_motion
from pinn_cli.record.response import Response
from pinn_cli.record.simulation import LARGEST_STATE, OverflowsError, response_of, simulate
from pinn_cli.record.steps import TooStiffError, method_needed, with_slow_followers
from pinn_cli.record.supports import support_motion
from pinn_cli.system.modes import modes_of
from pinn_cli.system.support import loose_dofs

if TYPE_CHECKING:
    from pinn_cli.record.record import Record
    from pinn_cli.record.runge_kutta import Force as History
    from pinn_cli.system.structure import Structure

# Steps of Runge-Kutta, 45 us each, that somebody waits for.
MOST_STEPS = 40_000
# Steps of Runge-Kutta that take as long as the implicit steps of a sample.
OF_IMPLICIT = 10
LINEAR = ("m", "c", "k")


class NoFreeRunError(ValueError):
    """A structure that cannot be left to itself under a record; the message is a sentence that says why."""


def free_run(
    structure: Structure, record: Record, start: Sequence[np.ndarray] | None = None, first: int = 0
) -> Response:
    """The response from a sample on, (N - first, n) each; the acceleration is in the record's frame.

    Args:
        structure: Any.
        record: For its times, what acts, its ``intersample`` and its frame.
        start: Displacement (m) and velocity (m/s) of the coordinates at sample ``first``, (n,) each, and hidden forces
            (h,), N, where there are any; None: rest.
        first: Sample to begin with.

    Raises:
        NoFreeRunError: A force is unknown, a mass is zero, the structure is too stiff, or its response does not stay
            finite.
    """
    _check(structure, record)
    part = slice(first, None)
    time, moved = record.time[part], record.ground_acceleration
    force = between_samples(time, record.force[part], record.intersample)
    ground = None if moved is None else BandLimited(time, moved[part])
    supports = support_motion(record, first)
    if is_linear(structure) and not len(structure.memory) and has_modes(modes := modes_of(structure)):
        u, v = linear_motion(modes, _pushes(structure, modes.m, force, ground, supports), time, start)
        finite = ((np.abs(u) < LARGEST_STATE) & (np.abs(v) < LARGEST_STATE)).all(axis=1)
        if not finite.all():
            raise _overflows(float(time[np.argmin(finite)]))
        moved, carried = None if moved is None else moved[part], None if supports is None else supports(time)
        motion = Response(time, u, v, v, record.force[part], moved, supports=carried)
        return response_of(structure, motion, record.frame)
    structure = with_slow_followers(structure, record.step)
    method, substeps = method_needed(structure, record.step)
    try:
        return simulate(
            structure, force, time, force.hold, method, substeps, initial=start, ground=ground, supports=supports,
            frame=record.frame,
        )  # fmt: skip
    except TooStiffError as error:
        raise NoFreeRunError(f"the structure is too stiff for a free run: {error}") from error
    except OverflowsError as error:
        raise _overflows(error.time) from error


def free_run_of(structure: Structure, record: Record, motion: Response, sample: int, first: int = 0) -> Response:
    """The same from a state of an estimated motion on.

    Args:
        structure: Any.
        record: See :func:`free_run`.
        motion: With the motion of the supports, where they move.
        sample: Of the motion, whose state the run begins with.
        first: Of the record, to begin with.

    Raises:
        NoFreeRunError: See :func:`free_run`.
    """
    if motion.supports is not None:
        record = replace(record, supports_begin=motion.supports[sample, :2])
    return free_run(structure, record, motion.state(sample), first)


def is_linear(structure: Structure) -> bool:
    """Whether every nonlinear parameter of a structure is zero."""
    return not any(bool(value.any()) for name, value in structure.parameters.items() if name not in LINEAR)


def affordable(structure: Structure, record: Record) -> Record:
    """The beginning of a record that a structure is followed through in two seconds or so; all of it by its modes."""
    if is_linear(structure) and not loose_dofs(structure):
        return record
    method, substeps = method_needed(with_slow_followers(structure, record.step), record.step)
    samples = MOST_STEPS // (substeps if method == "rk4" else OF_IMPLICIT)
    return record.until(samples) if samples < len(record.time) else record


def _check(structure: Structure, record: Record) -> None:
    unknown = np.flatnonzero(np.isnan(record.force).any(axis=0))
    if unknown.size:
        names = record.dof_names(unknown)
        raise NoFreeRunError(f"the force on {names} is unknown, and a free run needs every force")
    parameters = structure.parameters_like(np.empty(0))
    if not all(np.isfinite(value).all() for value in parameters.values()):
        raise NoFreeRunError("the structure has no free run: a parameter of it is no finite number")
    if not parameters["m"].all():
        raise NoFreeRunError("the structure is too stiff for a free run: a mass of it is zero")


def _overflows(time: float) -> NoFreeRunError:
    return NoFreeRunError(f"the structure is unstable: its free run overflows at {time:.4g} s")


def _pushes(
    structure: Structure, m: np.ndarray, force: History, ground: History | None, supports: History | None
) -> list[Push]:
    """What acts on the coordinates of a linear structure with masses m (n,), and what a unit of it does to them."""
    n = structure.coordinates
    pushes = [(force, structure.shapes.matrix / m)]
    if ground is not None:
        pushes.append((lambda at: ground(at)[:, None], -structure.with_ground[None]))
    if supports is not None:
        stretch = structure.stretch.matrix.toarray()
        by_displacement, by_velocity = (
            -(stretch[:, n:].T * values.sum(axis=0)) @ stretch[:, :n] / m for values in structure.at_rest()
        )
        pushes.append((lambda at: supports(at)[:, 0], by_displacement))
        pushes.append((lambda at: supports(at)[:, 1], by_velocity))
    return pushes
