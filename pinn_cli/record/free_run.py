"""The free run: what a structure does under the force of a record and the motion of its ground, left to itself.

No response sensor is looked at. What acts does between the samples what the record says
(:mod:`pinn_cli.record.between_samples`). A linear structure is followed exactly, another one
in steps that are as many as its fastest motion needs, and implicit ones where these would be too many.

Each mode of a linear structure (:mod:`pinn_cli.system.modes`) is an equation by itself, z' = lambda z + g, so

    z(t + h) = e^(lambda h) z(t) + int_0^h e^(lambda (h - s)) g(t + s) ds.

The load g of a step is the polynomial through its values at Gauss's points, and the integral of that is exact, however
fast or damped the mode is: no step is too long, and no structure too stiff.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import expm
from scipy.linalg.lapack import ztbtrs  # scipy.signal has a filter for it, but takes half a second to import

from pinn_cli.record.between_samples import BandLimited, between_samples
from pinn_cli.record.inputs import support_motion
from pinn_cli.record.record import Record
from pinn_cli.record.response import Response
from pinn_cli.record.simulation import LARGEST_STATE, OverflowsError, response_of, simulate
from pinn_cli.record.steps import Force as History
from pinn_cli.record.steps import TooStiffError, method_needed, with_slow_followers
from pinn_cli.system.connection.linear import Linear
from pinn_cli.system.coupling import loose_dofs
from pinn_cli.system.modes import Modes, modes_of
from pinn_cli.system.structure import Structure

# Histories, from times (M,), s, to (M, L), and what a unit of each does to the coordinates' accelerations, (L, n).
Push = tuple[Callable[[np.ndarray], np.ndarray], np.ndarray]

# Points of a step: a polynomial through eight follows a sine at the Nyquist frequency to 1e-5.
POINTS = 8
# Steps whose loads stand in memory at a time.
STEPS_AT_ONCE = 2048
# What modes may miss of the structure that they are of. Motions that share one shape and one pole, as that of a body
# that nothing holds, have no modes.
COMPLETE = 1e-7


def has_modes(modes: Modes) -> bool:
    """Whether the structure's motion is the sum of its modes': at time 0 they give back the state that they are of."""
    n, identity = len(modes.m), np.eye(len(modes.m))
    residual = np.hstack((modes.vectors @ modes.inputs, (modes.vectors * modes.poles) @ modes.inputs - identity))
    return bool(np.isfinite(residual).all() and np.abs(residual).max(initial=0.0) < COMPLETE * n)


def linear_motion(
    modes: Modes, pushes: Sequence[Push], time: np.ndarray, start: Sequence[np.ndarray] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and velocity of the coordinates at even times (N,), s, (N, n) each; not finite where they overflow.

    They start with a displacement and a velocity (n,); None: at rest.
    """
    u, v = (np.zeros(len(modes.m)),) * 2 if start is None else (np.asarray(x, dtype=float) for x in start)
    begins = modes.poles * (modes.inputs @ u) + modes.inputs @ ((modes.C @ u) / modes.m + v)
    upper = np.flatnonzero(modes.poles.imag >= 0.0)  # the others are their conjugates
    poles, step = modes.poles[upper], (time[-1] - time[0]) / (len(time) - 1)
    points = 0.5 + 0.5 * np.polynomial.legendre.leggauss(POINTS)[0]
    weights, inputs = step * _weights(poles * step, points), modes.inputs[upper].T
    out = np.empty((len(time), len(upper)), complex)
    out[0] = begins[upper]
    with np.errstate(over="ignore", invalid="ignore"):
        through = np.exp(poles * step)
        for first in range(0, len(time) - 1, STEPS_AT_ONCE):
            stop = min(first + STEPS_AT_ONCE, len(time) - 1)
            at = (time[first:stop, None] + step * points).reshape(-1)
            pushed = np.zeros((stop - first, len(upper)), complex)
            for history, influence in pushes:
                values = history(at)
                acting = values.any(axis=0)
                of_values = weights[:, None] * (influence[acting] @ inputs)
                columns = values[:, acting].reshape(stop - first, POINTS * int(acting.sum()))
                pushed += columns @ of_values.reshape(-1, len(upper))
            pushed[0] += through * out[first]
            for j, factor in enumerate(through):
                recursion = np.stack((np.ones(len(pushed)), np.full(len(pushed), -factor)))
                out[first + 1 : stop + 1, j] = ztbtrs(recursion, pushed[:, j, None], uplo="L", diag="U")[0][:, 0]
        shapes = modes.vectors[:, upper] * np.where(poles.imag > 0.0, 2.0, 1.0)
        return _real_part(out, shapes), _real_part(out, shapes * poles)


def _real_part(z: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    return np.asarray(z.real @ shapes.real.T - z.imag @ shapes.imag.T)


def _weights(z: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(P, J), by which values at points (P,) of a step, from 0 to 1, count in int_0^1 e^(z (1 - s)) g(s) ds; z (J,).

    The integrals of s^p / p! are the first row of an exponential (Van Loan 1978), for any z.
    """
    count = len(points)
    chain = np.zeros((len(z), count + 1, count + 1), complex)
    chain[:, 0, 0] = z
    chain[:, np.arange(count), np.arange(1, count + 1)] = 1.0
    integrals = expm(chain)[:, 0, 1:]
    factorial = np.cumprod(np.maximum(np.arange(count), 1.0))
    powers = points[:, None] ** np.arange(count) / factorial
    return np.asarray(np.linalg.solve(powers.T, integrals.T))


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
    """The same from a state of an estimated motion on; see :func:`free_run`."""
    if motion.supports is not None:
        record = replace(record, supports_begin=motion.supports[sample, :2])
    return free_run(structure, record, motion.state(sample), first)


def is_linear(structure: Structure) -> bool:
    """Whether all its laws are linear, or the parameters that make them others are zero."""
    linear = {kind for group in structure.groups if isinstance(group.nonlinearity, Linear) for kind in group.kinds}
    return not any(bool(x.any()) for kind, x in structure.parameters.items() if kind not in (*LINEAR, *linear))


def affordable(structure: Structure, record: Record) -> Record:
    """The beginning of a record that a structure is followed through in two seconds or so; all of it by its modes."""
    if is_linear(structure) and not loose_dofs(structure):
        return record
    method, substeps = method_needed(with_slow_followers(structure, record.step), record.step)
    samples = MOST_STEPS // (substeps if method == "rk4" else OF_IMPLICIT)
    return record.until(samples) if samples < len(record.time) else record


def _check(structure: Structure, record: Record) -> None:
    if record.unmeasured:
        raise NoFreeRunError(f"{record.unmeasured} is unknown, and a free run needs every force")
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
