"""Many structures under nearly the same force, followed side by side: how far what is uncertain moves the response."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from pinn_cli.record.record import Record
from pinn_cli.record.resimulation import force_spline
from pinn_cli.record.response import Response
from pinn_cli.record.runge_kutta import runge_kutta
from pinn_cli.record.steps import follower_masses, substeps_needed, with_slow_followers
from pinn_cli.system.structure import Structure

# Samples that are followed at a time: the forces of all members stand in memory for so long only.
CHUNK = 256


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
        place = np.minimum(place, 2 * last - place)
        before = np.minimum(place.astype(np.int64), last - 1)
        share = (place - before)[..., None]
        out: np.ndarray = self.history[before] * (1.0 - share) + self.history[before + 1] * share
        return self.sign[:, None] * out


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
    """

    parameters: Mapping[str, np.ndarray]
    start: np.ndarray
    sources: np.ndarray
    seed: int
    replay: Replay | None = None


def spread_of(members: Members, structure: Structure, record: Record, about: Response) -> Response:
    """Root mean square distance of the members' motion from a response, each (N, dofs).

    Args:
        members: At least one.
        structure: Whose law they share.
        record: Whose force and ground motion act on all.
        about: From which it is counted: that of the structure itself.
    """
    out = Response.unknown(record.time, record.ndof)
    with np.errstate(over="ignore", invalid="ignore"):
        for part, motion, _ in followed_members(members, structure, record):
            for name, values in motion.items():
                distance = values - getattr(about, name)[part, None]
                getattr(out, name)[part] = np.sqrt(np.mean(distance**2, axis=1))
    return out


def followed_members(
    members: Members, structure: Structure, record: Record
) -> Iterator[tuple[slice, dict[str, np.ndarray], np.ndarray]]:
    """The motion of all members, some hundred samples at a time: a step of Runge-Kutta takes about 0.2 ms.

    Args:
        members: At least one.
        structure: Whose law they share.
        record: Whose force and ground motion act on all.

    Yields:
        Samples, quantity to (M, H, dofs) at these, and the states (M, H, 2 n + h). Parts overlap by one sample.
    """
    masses, structure = follower_masses(structure, record.step), with_slow_followers(structure, record.step)
    members = replace(members, parameters={**members.parameters, "m": members.parameters["m"] * masses})
    substeps, samples = substeps_needed(structure, record.step), len(record.time)
    ensemble = _Ensemble(structure, members, record)
    random = np.random.default_rng(members.seed)
    state, last = members.start, _drawn(members, random, 0, 1)
    for first in range(0, samples - 1, CHUNK):
        stop = min(first + CHUNK, samples - 1) + 1
        noise = np.concatenate((last, _drawn(members, random, first + 1, stop)))
        states, load = ensemble.followed(state, noise, first, stop, substeps)
        ground = None if record.ground_acceleration is None else record.ground_acceleration[first:stop]
        yield slice(first, stop), ensemble.motion(states, load, ground), states
        state, last = states[-1], noise[-1:]


def _drawn(members: Members, random: np.random.Generator, first: int, stop: int) -> np.ndarray:
    """(M, H, n), the members' own forces at the samples first to stop (excluded)."""
    sources = members.sources
    forces: np.ndarray = random.standard_normal((stop - first, len(members.start), len(sources))) @ sources
    return forces if members.replay is None else forces + members.replay.at(np.arange(first, stop))


class _Ensemble:
    """The members' common equation of motion.

    Args:
        structure: In whose coordinates it is.
        members: Their parameters.
        record: The force and the ground's motion.
    """

    def __init__(self, structure: Structure, members: Members, record: Record) -> None:
        self.structure, self.parameters, self.record = structure, members.parameters, record
        self.n = structure.coordinates
        force = record.force if structure.shapes is None else structure.shapes.onto_coordinates(record.force)
        ground = record.ground_acceleration
        # Of the ground's motion, what it takes away from the accelerations; beside the force.
        self.load = np.stack((force, np.zeros_like(force)), axis=1)
        if ground is not None:
            self.load[:, 1] = ground[:, None] * structure.with_ground
        self.held = record.intersample == "zero_order_hold"
        self.between = None if self.held else force_spline(record.time, self.load)

    def followed(
        self, state: np.ndarray, noise: np.ndarray, first: int, stop: int, substeps: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """States and loads of all members at the samples first to stop (excluded)."""
        time = self.record.time[first:stop]

        def load(at: np.ndarray) -> np.ndarray:
            assert self.between is not None
            return self._with(self.between(at), _between(noise, (at - time[0]) / (time[1] - time[0])))

        sampled = self._with(self.load[first:stop], noise)
        hold = "zero_order" if self.held else "exact"
        return runge_kutta(self._slope, load, time, sampled, hold, substeps, state, None), sampled

    def motion(self, states: np.ndarray, load: np.ndarray, ground: np.ndarray | None) -> dict[str, np.ndarray]:
        """Quantity to (M, H, dofs), in the record's frame, under the ground's acceleration (M,)."""
        u, v, z = self._split(states)
        a = self.structure.acceleration(u, v, load[..., 0, :], self.parameters, z)
        shapes, carried = self.structure.shapes, load[..., 1, :]
        if self.record.frame == "relative" or shapes is not None:
            a = a - carried
        if shapes is not None:
            u, v, a = (shapes.of_dofs(x) for x in (u, v, a))
            if ground is not None and self.record.frame == "absolute":
                a = a + ground[:, None, None] * shapes.with_ground
        return {"displacement": u, "velocity": v, "acceleration": a}

    def _slope(self, state: np.ndarray, load: np.ndarray) -> np.ndarray:
        u, v, z = self._split(state)
        structure, p = self.structure, self.parameters
        acceleration = structure.acceleration(u, v, load[..., 0, :], p, z) - load[..., 1, :]
        if z is None:
            return np.concatenate((v, acceleration), axis=-1)
        rate = structure.hidden_rate(structure.elongation(u), structure.elongation(v), z, p)
        return np.concatenate((v, acceleration, rate), axis=-1)

    def _split(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        u, v, z = state[..., : self.n], state[..., self.n : 2 * self.n], state[..., 2 * self.n :]
        return u, v, z if z.shape[-1] else None

    @staticmethod
    def _with(load: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """(M, 2, n) and (M, H, n) as (M, H, 2, n)."""
        every = np.repeat(load[:, None], noise.shape[1], axis=1)
        every[:, :, 0] += noise
        return every


def _between(noise: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Samples (M, ...) at places between them, counted in samples."""
    before = np.clip(place.astype(np.int64), 0, len(noise) - 2)
    share = (place - before).reshape(-1, *[1] * (noise.ndim - 1))
    return noise[before] * (1.0 - share) + noise[before + 1] * share
