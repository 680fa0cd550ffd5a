"""Random structures and their motion, by numpy and scipy alone: nothing of the program under test is used."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.random import Generator
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.linalg import eigh, expm

from benchmarks.trust.case import UNKNOWN_STRUCTURE, Truth, record_data

Force = Callable[[float], np.ndarray]

RELATIVE, ABSOLUTE = 1e-9, 1e-12  # tolerances of the integration; the absolute one of the largest motion so far


@dataclass(frozen=True)
class Connection:
    """A connection of a structure.

    Attributes:
        name: In the settings and of its parameters: `k_NAME`.
        row: Its elongation is `row @ u`, (n,).
        law: Name of the law in the settings (`linear`, `duffing`, ...).
        values: Kind of parameter and value: {"c": ..., "k": ..., "kappa": ...}.
        force: Further force beside c e' + k e: of elongation, its rate and the memory z; N.
        memory: Rates of the numbers z that it remembers, of elongation, its rate and z, or None. The first one enters
            the force.
        remembered: How many.
        options: Settings of the law that are no parameters, such as `exponent`.
    """

    name: str
    row: np.ndarray
    law: str = "linear"
    values: dict[str, float] = field(default_factory=dict)
    force: Callable[[float, float, float], float] | None = None
    memory: Callable[[float, float, Sequence[float]], list[float]] | None = None
    remembered: int = 1
    options: dict[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class Structure:
    """Masses, connections and a damping of the whole.

    Attributes:
        dofs: Names (n).
        mass: kg, (n,).
        connections: Springs, dampers and what is nonlinear.
        damping: Further damping matrix, N s/m, (n, n), or None.
    """

    dofs: tuple[str, ...]
    mass: np.ndarray
    connections: tuple[Connection, ...]
    damping: np.ndarray | None = None

    @classmethod
    def chain(cls, mass: np.ndarray, name: str = "", dof: str = "x", **values: np.ndarray) -> Structure:
        """Storeys from the ground up.

        Args:
            mass: kg, (n,).
            name: What comes before the number of a connection.
            dof: What comes before that of a DOF.
            values: Of the connections by kind, (n,).
        """
        rows, numbers = np.eye(len(mass)) - np.eye(len(mass), k=-1), range(1, len(mass) + 1)
        links = (
            Connection(f"{name}{i}", row, values={kind: float(x[i - 1]) for kind, x in values.items()})
            for i, row in zip(numbers, rows, strict=True)
        )
        return cls(tuple(f"{dof}{i}" for i in numbers), mass, tuple(links))

    @property
    def n(self) -> int:
        """DOFs."""
        return len(self.mass)

    def matrix(self, kind: str) -> np.ndarray:
        """Sum of the connections' `kind` (`k` or `c`), (n, n); damping of the whole included."""
        found = np.zeros((self.n, self.n))
        for link in self.connections:
            found += link.values.get(kind, 0.0) * np.outer(link.row, link.row)
        return found + (self.damping if kind == "c" and self.damping is not None else 0.0)

    def modes(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies, Hz, (n,), and shapes of unit modal mass, (n, n), of the linear springs."""
        squared, shapes = eigh(self.matrix("k"), np.diag(self.mass))
        return np.sqrt(np.maximum(squared, 0.0)) / (2.0 * np.pi), shapes

    def with_values(self, kind: str, values: dict[str, float]) -> Structure:
        """The same with other values of one kind, by connection."""
        links = tuple(
            replace(link, values=link.values | ({kind: values[link.name]} if link.name in values else {}))
            for link in self.connections
        )
        return replace(self, connections=links)

    def tuned(self, first: float) -> Structure:
        """The same with the springs that give its first mode this frequency, Hz."""
        factor = (first / self.modes()[0][0]) ** 2
        return self.with_values("k", {link.name: link.values["k"] * factor for link in self.connections})

    def hardened(self, kappa: np.ndarray) -> Structure:
        """The same with cubic springs beside the linear ones, N/m^3, (connections,)."""
        links = (
            replace(link, law="duffing", force=lambda e, v, z, x=x: x * e**3)  # type: ignore[misc]
            for link, x in zip(self.connections, kappa, strict=True)
        )
        return replace(self, connections=tuple(links))

    def settings(self) -> dict[str, object]:
        """`system:` of an experiment, all parameters prescribed at their values."""
        links: dict[str, object] = {}
        for link in self.connections:
            row = {name: float(f"{x:.12g}") for name, x in zip(self.dofs, link.row, strict=True) if x != 0.0}
            links[link.name] = {"weights": row, "law": link.law, **link.values, **link.options}
        return {
            "dofs": list(self.dofs),
            "mass": dict(zip(self.dofs, self.mass.tolist(), strict=True)),
            "connections": links,
        }

    def unknown(self, **data: object) -> tuple[dict[str, object], dict[str, float]]:
        """An experiment at rest in which no connection has a value but n of Bouc-Wen, and what is to be found.

        Args:
            data: Of the record, beside its file and its time.
        """
        system = self.settings()
        for link in self.connections:
            system["connections"][link.name] |= {kind: 1.0 if kind == "n" else None for kind in link.values}  # type: ignore[index]
        found = {
            f"{kind}_{link.name}": x for link in self.connections for kind, x in link.values.items() if kind != "n"
        }
        settings: dict[str, object] = {
            "defaults": UNKNOWN_STRUCTURE,
            "system": system,
            "data": record_data(**data),
            "scheme": {"unknown": "missing", "initial_motion": "rest"},
        }
        return settings, found

    def columns(self, letter: str) -> dict[str, str]:
        """The channel of each DOF: the letter and its number."""
        return {dof: f"{letter}{i + 1}" for i, dof in enumerate(self.dofs)}

    def parameters(self, kinds: str = "ck") -> dict[str, float]:
        """Name as in `parameters.csv` and value, of the kinds that are letters of `kinds`."""
        return {f"{kind}_{link.name}": link.values[kind] for kind in kinds for link in self.connections
                if kind in link.values}  # fmt: skip


@dataclass(frozen=True)
class Motion:
    """Displacement, velocity, acceleration relative to the ground, (time, n), and the memories, (time, links)."""

    displacement: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    memory: np.ndarray

    def truth(self, parameters: dict[str, float], sensed: Iterable[int]) -> Truth:
        """What an estimate is compared with: these parameters and this motion; DOFs with a sensor, from 0."""
        return Truth(parameters, self.displacement, self.velocity, self.acceleration, tuple(map(int, sensed)))


def simulated(
    structure: Structure,
    force: Force,
    times: np.ndarray,
    highest: float,
    start: np.ndarray | None = None,
    method: str = "DOP853",
) -> Motion:
    """Motion at the times, by an integrator of scipy.

    Args:
        structure: What moves.
        force: External force at a time, N, (n,); of a ground that moves -m a_g.
        times: s, (time,); the first one is the beginning.
        highest: Highest frequency of force and structure, Hz: no step is longer than a tenth of its period.
        start: Displacements, then velocities (2 n,); None: at rest.
        method: Of `solve_ivp`; LSODA where a contact sticks.
    """
    n, links = structure.n, structure.connections
    C, K = structure.matrix("c"), structure.matrix("k")
    further = [(i, link) for i, link in enumerate(links) if link.force is not None]
    remembers = [(i, link) for i, link in enumerate(links) if link.memory is not None]
    ends = 2 * n + np.cumsum([0, *(link.remembered for _, link in remembers)])
    place = {i: slice(at, end) for (i, _), at, end in zip(remembers, ends, ends[1:], strict=False)}

    def motion(t: float, y: np.ndarray) -> np.ndarray:
        u, v = y[:n], y[n : 2 * n]
        pull = force(t) - C @ v - K @ u
        for i, link in further:
            assert link.force is not None
            z = y[place[i]][0] if i in place else 0.0
            pull = pull - link.row * link.force(float(link.row @ u), float(link.row @ v), float(z))
        rates = [
            link.memory(float(link.row @ u), float(link.row @ v), y[place[i]])
            for i, link in remembers
            if link.memory is not None
        ]
        return np.concatenate([v, pull / structure.mass, *rates])

    y0 = np.zeros(ends[-1])
    if start is not None:
        y0[: 2 * n] = start
    scale = float(np.abs(force(times[len(times) // 3])).max() + np.abs(K @ y0[:n]).max())
    small = ABSOLUTE * max(scale, 1e-300) / max(float(np.abs(np.diag(K)).max()), 1e-300)
    solve = partial(
        solve_ivp, motion, (times[0], times[-1]), y0, t_eval=times, rtol=RELATIVE, atol=max(small, 1e-30),
        max_step=0.1 / highest, first_step=0.01 / highest,
    )  # fmt: skip
    solution = solve(method=method)
    if not solution.success:  # a joint that pinches may be too sharp for the corrector of LSODA
        solution = solve(method="DOP853")
    found = solution.y.T
    acceleration = np.array([motion(t, y)[n : 2 * n] for t, y in zip(times, found, strict=True)])
    return Motion(found[:, :n], found[:, n : 2 * n], acceleration, found[:, 2 * n :])


def linear_motion(
    structure: Structure, force: Callable[[np.ndarray], np.ndarray], times: np.ndarray, highest: float
) -> Motion:
    """Motion of a linear structure from rest, by matrix exponentials: exact for the spline through the force.

    It has 60 points or more in the shortest period.

    Args:
        structure: What moves; of its connections c and k count.
        force: External force at times, N: (time,) to (time, n); of a ground that moves -m a_g.
        times: s, (time,), uniform; the structure is at rest at the first one.
        highest: Highest frequency of force and structure, Hz.
    """
    n = structure.n
    between = int(np.ceil(60.0 * highest * (times[1] - times[0])))
    h = (times[1] - times[0]) / between
    fine = times[0] + h * np.arange((len(times) - 1) * between + 1)
    C, K = structure.matrix("c"), structure.matrix("k")
    cubics = CubicSpline(fine, force(fine)).c * h ** np.array([3, 2, 1, 0])[:, None, None]  # of steps as long as 1
    generator = np.zeros((6 * n, 6 * n))  # of u, h v and the force's cubic: f, then s times its derivatives' terms
    generator[:n, n : 2 * n] = np.eye(n)
    generator[n : 2 * n, :n] = -(h**2) * K / structure.mass[:, None]
    generator[n : 2 * n, n : 2 * n] = -h * C / structure.mass[:, None]
    generator[n : 2 * n, 2 * n : 3 * n] = np.diag(h**2 / structure.mass)
    for order in (1, 2, 3):  # x_order = order! (its coefficient), whose integral is x_(order - 1)
        generator[(1 + order) * n : (2 + order) * n, (2 + order) * n : (3 + order) * n] = np.eye(n)
    step = expm(generator)[: 2 * n]
    pushed = np.concatenate([factor * cubics[3 - i] for i, factor in enumerate((1.0, 1.0, 2.0, 6.0))], axis=1)
    pushed = pushed @ step[:, 2 * n :].T
    states = np.zeros((len(fine), 2 * n))
    free = np.ascontiguousarray(step[:, : 2 * n])
    for i, push in enumerate(pushed):
        states[i + 1] = free @ states[i] + push
    u, v = states[::between, :n], states[::between, n:] / h
    return Motion(u, v, (force(times) - v @ C - u @ K) / structure.mass, np.zeros((len(times), 0)))


def damping_matrix(structure: Structure, ratios: np.ndarray) -> np.ndarray:
    """Damping matrix (n, n) with a ratio for each mode, the lowest first, (n,)."""
    frequencies, shapes = structure.modes()
    weighed = structure.mass[:, None] * shapes
    return (weighed * (4.0 * np.pi * ratios * frequencies)) @ weighed.T


def uncertainty(structure: Structure, where: np.ndarray, sensed: np.ndarray, band: np.ndarray, amount: float) -> float:
    """Largest relative standard deviation of a stiffness that the best estimate could have (Cramér and Rao).

    Stiffnesses and dampers of all connections are unknown, forces known; channels of any kind have white noise.

    Args:
        structure: Linear.
        where: DOFs of the forces, (n, forces); flat spectra.
        sensed: DOFs of the sensors.
        band: Frequencies of the forces, Hz, dense beside the resonances.
        amount: Samples times the ratio of the power of signal and noise.
    """
    rows = np.array([link.row for link in structure.connections])
    s = 2j * np.pi * band[:, None, None]
    inverse = np.linalg.inv(s**2 * np.diag(structure.mass) + s * structure.matrix("c") + structure.matrix("k"))
    response = inverse[:, sensed] @ where
    by_k = np.einsum("fsn,ln,flw->fswl", inverse[:, sensed], rows, rows @ inverse @ where)
    by_k = by_k * np.array([link.values["k"] for link in structure.connections])
    relative = np.concatenate([by_k, by_k * s[..., None] / np.abs(s).max()], axis=-1)
    power = (np.abs(response) ** 2).sum(axis=(0, 2))
    told = np.einsum("fswl,fswm,s->lm", relative.conj(), relative, amount / np.maximum(power, 1e-300)).real
    spread = np.sqrt(np.diag(told))
    if not np.all(spread > 0.0):
        return float("inf")  # a part that nothing moves or nothing senses
    squares = np.diag(np.linalg.pinv(told / np.outer(spread, spread), rcond=1e-14, hermitian=True))
    return float(np.sqrt(np.max(squares[: len(rows)] / spread[: len(rows)] ** 2)))


def storeys(rng: Generator, n: int, braced: float) -> dict[str, np.ndarray]:
    """Rows of the storeys by name and, in this share of all cases, of a brace over two of them."""
    rows = {f"storey_{i + 1}": row for i, row in enumerate(np.eye(n) - np.eye(n, k=-1))}
    if n > 1 and rng.random() < braced:
        top = int(rng.integers(1, n))
        rows["brace"] = np.eye(n)[top] - (np.eye(n)[top - 2] if top > 1 else 0.0)
    return rows


def sinusoids(
    rng: Generator, low: float, high: float, rms: float, lines: int = 300
) -> Callable[[np.ndarray], np.ndarray]:
    """Gaussian noise of a band as a function of time: a sum of sinusoids that is switched on over one long period."""
    frequency, phase = rng.uniform(low, high, lines), rng.uniform(0.0, 2.0 * np.pi, lines)

    def force(t: np.ndarray) -> np.ndarray:
        t = np.asarray(t, float)
        waves = np.cos(2.0 * np.pi * frequency * t[..., None] + phase).sum(axis=-1)
        return np.clip(t * low, 0.0, 1.0) * rms * np.sqrt(2.0 / lines) * waves

    return force


def noise(values: np.ndarray, decibel: float) -> float:
    """Standard deviation of the white noise that gives a channel a signal-to-noise ratio, dB."""
    return float(values.std()) * 10.0 ** (-decibel / 20.0)


def noisy(rng: Generator, values: np.ndarray, decibel: float) -> np.ndarray:
    """A channel with white noise of a signal-to-noise ratio, dB."""
    return values + rng.normal(size=len(values)) * noise(values, decibel)
