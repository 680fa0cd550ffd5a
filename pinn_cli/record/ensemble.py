"""Many structures under nearly the same force, followed side by side: how far what is uncertain moves the response."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pinn_cli.record.between_samples import between_samples
from pinn_cli.record.inputs import SupportErrors, support_motion
from pinn_cli.record.record import Record
from pinn_cli.record.response import Response
from pinn_cli.record.runge_kutta import runge_kutta
from pinn_cli.record.simulation import StateEquation
from pinn_cli.record.steps import (
    TURNS_OVER,
    follower_masses,
    implicit_steps,
    made_in_a_sample,
    method_needed,
    with_slow_followers,
)
from pinn_cli.system.structure import Structure

# Samples that are followed at a time: the forces of all members stand in memory for so long only.
SAMPLES_AT_ONCE = 256
# Straight parts of a load between two samples, where members take their own steps.
STRAIGHT_PARTS = 8
# Of these each takes as long as a whole ensemble in common steps: so many tell a deviation to a seventh.
OWN_STEPS = 24


@dataclass(frozen=True, eq=False)
class Replay:
    """A force that acted once and acts on every member from another place of it on, with either sign.

    Its end is its beginning backwards. So members have its spectrum and what its columns have in common, and nothing
    of when it came.

    Attributes:
        history: (L, n), N, in the equations of the coordinates; L at least 2.
        rate: Samples of it for every one of the new record.
        first: (H,), place in it at which a member begins, from 0 to 2 (L - 1).
        sign: (H,).
    """

    history: np.ndarray
    rate: float
    first: np.ndarray
    sign: np.ndarray

    @classmethod
    def drawn(cls, history: np.ndarray, rate: float, count: int, seed: int) -> Replay:
        """Places and signs at random."""
        random = np.random.default_rng([seed, 3])
        first = random.integers(0, 2 * (len(history) - 1), count)
        return cls(history, rate, first, random.choice([-1.0, 1.0], count))

    def at(self, samples: np.ndarray) -> np.ndarray:
        """(M, H, n) at samples (M,) of the new record."""
        last = len(self.history) - 1
        place = (self.first + self.rate * samples[:, None]) % (2 * last)
        return self.sign[:, None] * _between(self.history, np.minimum(place, 2 * last - place))


@dataclass(frozen=True, eq=False)
class Members:
    """What differs from member to member, H of them.

    Attributes:
        parameters: Kind to (H, members of the kind), of the structure.
        start: (H, 2 n + h), displacement, velocity and hidden forces at the first sample.
        sources: (P, n), N: independent white forces, a row for what one standard deviation of each puts into the
            equations of the coordinates at a sample. Between samples they go in straight lines.
        seed: Of their values.
        replay: A force beside them; None: there is none.
        carried: Errors of what was measured of supports that move; None: none moves, or what was measured is right.
    """

    parameters: Mapping[str, np.ndarray]
    start: np.ndarray
    sources: np.ndarray
    seed: int
    replay: Replay | None = None
    carried: SupportErrors | None = None

    def with_parameters_of(self, structure: Structure) -> dict[str, np.ndarray]:
        """Kind to (H + 1, members of the kind), those of the structure itself behind the members'."""
        of_structure = structure.parameters_like(np.empty(0))
        return {kind: np.concatenate((values, of_structure[kind][None])) for kind, values in self.parameters.items()}


def affordable_members(structure: Structure, record: Record, count: int) -> int:
    """So many as are asked for; fewer where each takes its own steps."""
    return count if method_needed(structure, record.step)[0] == "rk4" else min(count, OWN_STEPS)


def spread_of(members: Members, structure: Structure, record: Record, about: Response) -> Response:
    """Root mean square distance of the members' motion from that of the structure itself, each (N, dofs)."""
    out = Response.unknown(record.time, record.ndof)
    with np.errstate(over="ignore", invalid="ignore"):
        for part, motion, _, _ in followed_members(members, structure, record, about.state(0)):
            for name, values in motion.items():
                getattr(out, name)[part] = distance(values)
    return out


def distance(values: np.ndarray) -> np.ndarray:
    """(M, ...), root mean square distance of the first H of values (M, H + 1, ...) from the last."""
    return np.asarray(np.sqrt(np.mean((values[:, :-1] - values[:, -1:]) ** 2, axis=1)))


def followed_members(
    members: Members, structure: Structure, record: Record, start: Sequence[np.ndarray]
) -> Iterator[tuple[slice, dict[str, np.ndarray], np.ndarray, np.ndarray]]:
    """The motion of all members, one at least, some hundred samples at a time, under what acts by the record.

    Behind them comes that of the structure itself, from its own displacement, velocity and hidden forces at the first
    sample: from it they differ by what is uncertain alone, and the steps that all of them take are no part of it. A
    step of Runge-Kutta takes about 0.2 ms.

    Yields:
        Samples, quantity to (M, H + 1, dofs) at these, the states (M, H + 1, 2 n + h), and displacement and velocity of
        the supports (M, H + 1, 2, S). Parts overlap by one sample.
    """
    parameters = members.with_parameters_of(structure)
    parameters["m"] = parameters["m"] * follower_masses(structure, record.step)
    structure = with_slow_followers(structure, record.step)
    ensemble, samples = _Ensemble(structure, parameters, record), len(record.time)
    random = np.random.default_rng(members.seed)
    state = np.concatenate((members.start, np.concatenate(start)[None]))
    last, carried = _drawn(members, random, 0, 1), members.carried
    errors = np.zeros((1, len(members.start), 3, structure.supports))
    for first in range(0, samples - 1, SAMPLES_AT_ONCE):
        stop = min(first + SAMPLES_AT_ONCE, samples - 1) + 1
        noise = np.concatenate((last, _drawn(members, random, first + 1, stop)))
        errors = errors[-1:] if carried is None else carried.drawn(random, len(noise) - 1, errors[-1])
        states, load = ensemble.followed(state, ensemble.load_deviations(noise, errors), slice(first, stop))
        ground = None if record.ground_acceleration is None else record.ground_acceleration[first:stop]
        yield slice(first, stop), ensemble.motion(states, load, ground), states, load[..., ensemble.n :]
        state, last = states[-1], noise[-1:]


def _drawn(members: Members, random: np.random.Generator, first: int, stop: int) -> np.ndarray:
    """(M, H, n), the members' own forces at the samples first to stop (excluded)."""
    sources = members.sources
    forces: np.ndarray = random.standard_normal((stop - first, len(members.start), len(sources))) @ sources
    return forces if members.replay is None else forces + members.replay.at(np.arange(first, stop))


class _Ensemble:
    """The members' common equation of motion, in a structure's coordinates, with the parameters of each."""

    def __init__(self, structure: Structure, parameters: Mapping[str, np.ndarray], record: Record) -> None:
        self.structure, self.record, self.n = structure, record, structure.coordinates
        # How far the ground moves each coordinate is in the load.
        self.equation = StateEquation(replace(structure, influence=None), parameters, shaken=True)
        force = structure.shapes.onto_coordinates(record.force)
        ground = record.ground_acceleration
        # Of the ground's motion, what it takes away from the accelerations; beside the force.
        self.load = np.stack((force, np.zeros_like(force)), axis=1)
        if ground is not None:
            self.load[:, 1] = ground[:, None] * structure.with_ground
        self.supports = support_motion(record)
        self.between = between_samples(record.time, self.load, record.intersample)

    def followed(self, state: np.ndarray, deviations: np.ndarray, part: slice) -> tuple[np.ndarray, np.ndarray]:
        """States and loads of all members at some samples, from what each has of a load for its own."""
        time = self.record.time[part]
        method, substeps = method_needed(self.structure, self.record.step)

        def load(at: np.ndarray) -> np.ndarray:
            place = (at - time[0]) / (time[1] - time[0])
            return self._with_supports(at, self.between(at))[:, None] + _between(deviations, place)

        sampled = self._with_supports(time, self.load[part])[:, None] + deviations
        hold = self.between.hold
        if method == "rk4":
            return runge_kutta(self.equation.slope, load, time, sampled, hold, substeps, state, None), sampled
        # A stiff law has each member take its own steps, many of them.
        grid = np.linspace(time[0], time[-1], STRAIGHT_PARTS * (len(time) - 1) + 1)
        table, histories = sampled if hold == "zero_order" else load(grid), []
        for i in range(len(state)):
            member_load = table[:, i : i + 1]
            acting = lambda at, member_load=member_load: _between(member_load, (at - time[0]) / (grid[1] - grid[0]))  # noqa: E731
            shown, start = sampled[:, i : i + 1], state[i : i + 1]
            own = {kind: values[i : i + 1] for kind, values in self.equation.parameters.items()}
            member = replace(self.equation, parameters=own)
            size = made_in_a_sample(member.slope, shown, start, float(time[1] - time[0]), self.n)
            member = replace(member, structure=member.structure.turning_over(TURNS_OVER * float(size[self.n])))
            histories.append(implicit_steps(member.slope, acting, time, shown, hold, start, size))
        return np.concatenate(histories, axis=1), sampled

    def motion(self, states: np.ndarray, load: np.ndarray, ground: np.ndarray | None) -> dict[str, np.ndarray]:
        """Quantity to (M, H, dofs), in the record's frame, under the ground's acceleration (M,)."""
        u, v, z = self.equation.split(states)
        a = self.equation.acceleration(*self.equation.stretching(u, v, load), load, z)
        shapes = self.structure.shapes
        u, v, a = (shapes.of_dofs(x) for x in (u, v, a))
        if ground is not None and self.record.frame == "absolute":
            a = a + ground[:, None, None] * shapes.with_ground
        return {"displacement": u, "velocity": v, "acceleration": a}

    def _with_supports(self, at: np.ndarray, load: np.ndarray) -> np.ndarray:
        """(M, 2, n + S), a load with the motion of the supports at times (M,)."""
        return load if self.supports is None else np.concatenate((load, self.supports(at)[:, :2]), axis=2)

    def load_deviations(self, noise: np.ndarray, errors: np.ndarray) -> np.ndarray:
        """(M, H + 1, 2, n + S), members' own forces (M, H, n) and errors (M, H, 3, S) of supports as loads."""
        samples, members, _ = noise.shape
        deviations = np.zeros((samples, members + 1, 2, self.n + self.structure.supports))
        deviations[:, :-1, 0, : self.n] = noise
        deviations[:, :-1, :, self.n :] = errors[:, :, :2]
        return deviations


def _between(noise: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Samples (M, ...) at places (...) between them, counted in samples."""
    before = np.clip(place.astype(np.int64), 0, len(noise) - 2)
    share = (place - before).reshape(*place.shape, *[1] * (noise.ndim - 1))
    return noise[before] * (1.0 - share) + noise[before + 1] * share
