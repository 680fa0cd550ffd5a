"""Forces that a model may lack: columns, in the equations of motion, of connections, masses, load cells, oscillators.

Each is a history at the collocation points, of the estimated motion and of unit size, and how the coordinates feel it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, combinations

import numpy as np
import torch
from scipy.sparse import bmat, csr_matrix
from scipy.sparse.csgraph import shortest_path
from torch import Tensor

from pinn_cli.record.channel import WIDEST_DELAY
from pinn_cli.record.spectrum import signal_band
from pinn_cli.system.damping import RATIO
from pinn_cli.system.functions import Jet
from pinn_cli.system.left_out import (
    DAMPED_MODE,
    LEFT_OUT,
    LINK,
    MODE,
    ROCKING,
    SLIDES_AT,
    SLIDING,
    SPRING,
    Carried,
    LeftOut,
    rms,
    sliding,
)
from pinn_cli.system.modes import at_rest, undamped_modes
from pinn_cli.system.parameters import MASS
from pinn_cli.system.quantities import FORCE, MOTION
from pinn_cli.system.structure import Structure
from pinn_cli.training.doubts.other_damping import USUAL
from pinn_cli.training.doubts.sensor_doubts import DELAY, Term, delays
from pinn_cli.training.factors.channel_at_point import sparse_rows
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_equations import NormalEquations

# Oscillators that are attached are tried at frequencies in this ratio at first, or in a larger one, and damped so that
# they reach each other; then nearer, with these damping ratios. Periods in the record of the lowest, and how many are
# tried in all.
OSCILLATOR_RATIO, DAMPED, OSCILLATOR_PERIODS, MOST_OSCILLATORS = 1.08, (0.005, 0.015, 0.04), 8.0, 160
# Shapes of a term that are tried at once.
FINER = 7


@dataclass(frozen=True, eq=False)
class ForceTerm:
    """A force that the motion may take beside those of the model.

    Attributes:
        term: What.
        distribution: (functions,), how much of it every equation of motion has.
        history: (P,), N at one prior standard deviation, at the collocation points.
        reshaped: The same of another shape, in one or several ways; None: it has none.
        ratio: Of the shapes that are tried.
        below: What they stay below.
    """

    term: Term
    distribution: np.ndarray
    history: np.ndarray
    reshaped: Callable[[float], Iterable[ForceTerm]] | None = None
    ratio: float = 1.0
    below: float = np.inf

    def finer(self, span: float) -> list[ForceTerm]:
        """The same of shapes that are nearer, from the one below to the one above where ``span`` is one."""
        if self.reshaped is None:
            return []
        shapes = self.term.shape * self.ratio ** (span * np.linspace(-1.0, 1.0, FINER))
        return [term for shape in shapes[shapes < self.below] for term in self.reshaped(float(shape))]


@dataclass(frozen=True, eq=False)
class _Forces:
    """Makes the forces of one record.

    Attributes:
        equations: Of the record.
        point: Their solution.
        highest: Frequency, Hz, up to which sensors show it.
    """

    equations: NormalEquations
    point: Point
    highest: float

    @cached_property
    def motion(self) -> Jet:
        """At the collocation points."""
        return Jet(*self.equations.flat_states(self.equations.physics, self.point)[:3])

    @cached_property
    def structure(self) -> Structure:
        """With the parameters of the point."""
        return structure_at(self.equations, self.point)

    @cached_property
    def of_motion(self) -> tuple[np.ndarray, ...]:
        """See :func:`connection_force`."""
        return connection_force(self.equations, self.point, self.motion)

    @cached_property
    def place(self) -> np.ndarray:
        """(dofs, n), how far every DOF moves with every coordinate, and how a force on it pulls at them."""
        dynamics = self.equations.dynamics
        ((_, functions),) = dynamics.sensing("displacement")
        place: np.ndarray = functions.toarray()[:, : dynamics.ndof]
        return place

    @cached_property
    def acceleration(self) -> np.ndarray:
        """(P, dofs), m/s^2, what a mass on every DOF feels."""
        dynamics = self.equations.dynamics
        moved = self.motion.curvature[:, : dynamics.ndof].numpy() @ self.place.T
        if not dynamics.inputs.ground:
            return moved
        return moved + self.motion.value[:, dynamics.ground].numpy() * dynamics.carried

    @cached_property
    def mass(self) -> np.ndarray:
        """(dofs,), kg, what moves with every DOF that a force on it moves alone."""
        masses = self.equations.prescribed[MASS].numpy()
        light = np.divide(
            self.place**2, masses, out=np.zeros_like(self.place), where=(self.place != 0.0) & (masses > 0.0)
        )
        return np.divide(1.0, light.sum(1), out=np.zeros(len(light)), where=light.sum(1) > 0.0)

    def term(self, term: Term, pull: np.ndarray, unit: np.ndarray, size: float) -> ForceTerm:
        """With a prior standard deviation that makes its force so large, rms; ``pull`` is (coordinates,)."""
        scale = max(size, 1e-300) / max(rms(unit), 1e-300)
        distribution = self.equations.dynamics.padded(torch.as_tensor(pull)).numpy()
        return ForceTerm(replace(term, scale=scale), distribution, scale * unit)

    def of_connections(self) -> Iterator[ForceTerm]:
        """What a connection may have beside its law, and more or less of what its law has but is held."""
        structure = self.equations.dynamics.structure
        most = {kind.kind: self._most(kind.parameter) for kind in LEFT_OUT}
        pulls = structure.incidence.matrix[structure.added].toarray()
        histories = (x[:, structure.added].T for x in self.of_motion)
        for connection, pull, e, de, force in zip(structure.added.tolist(), pulls, *histories, strict=True):
            of, state = f"connection {structure.labels.connection(connection)}", (pull, e, de, rms(force))
            for kind in (kind for kind in LEFT_OUT if not np.isnan(most[kind.kind][connection])):
                bounded = replace(kind, most=float(most[kind.kind][connection]))
                yield from (self.of_connection(shape * rms(e), bounded, of, state) for shape in kind.shapes)

    def of_links(self) -> Iterator[ForceTerm]:
        """A spring between two DOFs, or from one to the ground, that no connection joins."""
        structure, record = self.equations.dynamics.structure, self.equations.problem.record
        if structure.is_modal:
            return
        joined = {tuple(np.flatnonzero(row).tolist()) for row in structure.incidence.matrix.toarray()}
        moved = self.motion.value[:, : len(self.place)].numpy()
        size = float(np.median([rms(force) for force in self.of_motion[2].T]))
        for ends in chain.from_iterable(combinations(range(len(self.place)), count) for count in (1, 2)):
            if ends in joined:
                continue
            pull = np.zeros(len(self.place))
            pull[list(ends)] = (-1.0, 1.0)[-len(ends) :]
            of = record.dof_names(ends) if len(ends) > 1 else f"DOF {record.dof_name(*ends)} and the ground"
            yield self.term(Term(LINK, of, "N/m", 1.0, least=0.0), pull, moved @ pull, size)

    def _most(self, kind: str) -> np.ndarray:
        """(C,), what connections lack at most of what a parameter says: below its bound, 0; NaN: it may move itself."""
        structure = self.equations.dynamics.structure
        connections, member = structure.carriers.get(kind, (np.zeros(0, dtype=int),) * 2)
        most = np.full(len(structure.parameters[SPRING]), np.inf)
        at_bound = self.point.parameters.numpy() <= self.equations.lower
        for p, held in zip(self.equations.uncertain, at_bound.tolist(), strict=True):
            if p.kind == kind:
                most[connections[member == p.index]] = 0.0 if held else np.nan
        return most

    def of_connection(
        self, shape: float, kind: LeftOut, of: str, state: tuple[np.ndarray, np.ndarray, np.ndarray, float]
    ) -> ForceTerm:
        """One of them."""
        pull, e, de, size = state
        plain = self.term(
            Term(kind.kind, of, kind.unit, 1.0, shape, kind.least, kind.most), pull, kind.force(e, de, shape), size
        )
        if len(kind.shapes) == 1:
            return plain
        ratio = kind.shapes[1] / kind.shapes[0]
        return replace(plain, reshaped=lambda shape: [self.of_connection(shape, kind, of, state)], ratio=ratio)

    def of_masses(self) -> Iterator[ForceTerm]:
        """More or less mass on a DOF, but where its mass is a parameter that may move."""
        problem = self.equations.problem
        of_dofs = not problem.structure.is_modal
        moving = {p.index for p in problem.uncertain if of_dofs and p.kind == MASS}
        for dof in (dof for dof in range(len(self.place)) if dof not in moving):
            name, acceleration = f"DOF {problem.record.dof_name(dof)}", self.acceleration[:, dof]
            size = self.mass[dof] * rms(acceleration)
            whole = Term(MASS, name, "kg", 1.0, least=-float(self.mass[dof]))  # no mass is left
            yield self.term(whole, self.place[dof], acceleration, size)

    def of_sliding_masses(self) -> Iterator[ForceTerm]:
        """A part of what a DOF carries that slides on it."""
        for dof in np.flatnonzero(self.mass > 0.0).tolist():
            size = rms(self.acceleration[:, dof])
            yield from (self.of_sliding_mass(at * size, dof) for at in SLIDES_AT if size > 0.0)

    def of_sliding_mass(self, at: float, dof: int) -> ForceTerm:
        """One of them."""
        moved = self.acceleration[:, dof]
        lying = Term(SLIDING, f"DOF {self.equations.problem.record.dof_name(dof)}", "kg", 1.0, at, least=0.0)
        plain = self.term(lying, self.place[dof], sliding(moved, self.step, at), self.mass[dof] * rms(moved))
        ratio = SLIDES_AT[1] / SLIDES_AT[0]
        return replace(plain, reshaped=lambda at: [self.of_sliding_mass(at, dof)], ratio=ratio)

    def of_modes(self) -> Iterator[ForceTerm]:
        """More or less damping of a mode, but where its ratio is a parameter that may move."""
        modes = undamped_modes(self.structure)
        if modes is None:
            return
        moving = {p.index for p in self.equations.uncertain if p.kind == RATIO}
        rate = self.motion.rate[:, : self.equations.dynamics.ndof].numpy()
        mass = self.equations.parameters(self.point)[MASS].numpy()
        squares, shapes = modes
        for mode, (square, shape) in enumerate(zip(squares, shapes.T, strict=True)):
            omega, pull = max(square, 0.0) ** 0.5, mass * shape
            if 0.0 < omega < 2.0 * np.pi * self.highest and mode not in moving:
                unit = 2.0 * omega * (rate @ pull)
                yield self.term(Term(DAMPED_MODE, f"mode {mode + 1}", "", 1.0), pull, unit, USUAL * rms(unit))

    def of_base(self) -> Iterator[ForceTerm]:
        """A base that rocks, where storeys stand one on another: those of one height turn with it.

        As by a spring in series: the moment about the base takes a part of itself back, from every storey.
        """
        incidence, is_modal = self.structure.incidence.matrix, self.structure.is_modal
        heights = np.empty(0) if is_modal else _storeys(incidence)
        if len(heights) < 2 or not np.isfinite(heights).all():
            return
        turned, stiffness = incidence @ heights, at_rest(self.structure)[0]
        against = float(stiffness @ turned**2)
        if against > 0.0:
            unit, pull = -(self.of_motion[2] @ turned) / against, incidence.T @ (stiffness * turned)
            size = rms(unit) * rms(pull)
            yield self.term(Term(ROCKING, "base", "", 1.0, least=0.0), pull, unit, size)

    def of_loads(self) -> Iterator[ForceTerm]:
        """Load cells that show a force late; what is above their band is noise, which a derivative makes more of."""
        record = self.equations.problem.record
        for dof in np.flatnonzero(record.sensors(FORCE)).tolist():
            shown = self.equations.target.force[:, dof].numpy()
            rate = _rate(shown, self.step, signal_band(record.force[:, dof], record.step))
            late = Term(DELAY, f"force on DOF {record.dof_name(dof)}", "s", 1.0, np.nan, *delays(shown, rate))
            yield self.term(late, self.place[dof], -rate, WIDEST_DELAY * record.step * rms(rate))

    def of_oscillators(self) -> Iterator[ForceTerm]:
        """One mode more, on a DOF with a sensor or under a force."""
        record, inputs = self.equations.problem.record, self.equations.problem.record.sensors(FORCE)
        dofs = np.flatnonzero(np.any([inputs, *(record.sensors(q) for q in MOTION)], axis=0)).tolist()
        lowest, highest = OSCILLATOR_PERIODS / record.duration, self.highest
        per_dof, reach = MOST_OSCILLATORS // max(len(dofs), 1), np.log(max(highest / lowest, 1.0))
        if not per_dof:
            return
        ratio = max(OSCILLATOR_RATIO, float(np.exp(reach / per_dof)))
        # At the edge of the band an oscillator is what a mass is.
        for frequency in highest / ratio ** np.arange(1, 1 + int(reach / np.log(ratio) * (1.0 - 1e-9))):
            yield from (self.of_oscillator(float(frequency), dof, ratio, (ratio - 1.0) / 2.0) for dof in dofs)

    def of_oscillator(self, frequency: float, dof: int, ratio: float, damping: float) -> ForceTerm:
        """One of them, of frequencies that are tried in a ratio."""
        moved, record = self.acceleration[:, dof], self.equations.problem.record
        mode = Term(MODE, f"DOF {record.dof_name(dof)}", "kg", 1.0, frequency)
        driven = self.carried.oscillator(dof, frequency, damping)
        plain = self.term(mode, self.place[dof], driven, self.mass[dof] * rms(moved))
        again = lambda finer: [self.of_oscillator(finer, dof, ratio, at) for at in DAMPED]  # noqa: E731
        return replace(plain, reshaped=again, ratio=ratio, below=self.highest / ratio**0.5)

    @cached_property
    def carried(self) -> Carried:
        """By the DOFs."""
        return Carried(self.acceleration, self.step)

    @property
    def step(self) -> float:
        """Between collocation points, s."""
        first, second = self.equations.target.physics_time[:2].tolist()
        return float(second - first)


def force_terms(equations: NormalEquations, point: Point, highest: float) -> list[ForceTerm]:
    """Of connections, masses, what DOFs carry up to a frequency, Hz, and load cells."""
    made = _Forces(equations, point, highest)
    loads = () if equations.problem.inputs.loads else made.of_loads()  # or they are channels, see `sensor_terms`
    of_modes = (*made.of_modes(), *made.of_base())
    carried = (*of_modes, *made.of_masses(), *made.of_sliding_masses(), *made.of_oscillators())
    return [*made.of_connections(), *made.of_links(), *carried, *loads]


def _storeys(incidence: csr_matrix) -> np.ndarray:
    """(n,), connections from every coordinate to the ground; infinite where it stands on it in no way, or in two."""
    ends = incidence != 0
    grounded = csr_matrix((ends.sum(axis=1) == 1).astype(float))
    between = csr_matrix(bmat([[None, grounded.T @ ends], [ends.T @ grounded, ends.T @ ends]]))
    storeys: np.ndarray = shortest_path(between, unweighted=True, indices=0)[1:]
    is_tree = np.count_nonzero(np.triu(between.toarray(), 1)) == len(storeys)
    return storeys if is_tree else np.full(len(storeys), np.inf)


def structure_at(equations: NormalEquations, point: Point) -> Structure:
    """With the parameters of a point."""
    structure, values = equations.dynamics.structure, equations.parameters(point)
    return replace(structure, parameters={kind: values[kind] for kind in structure.parameters})


def connection_force(equations: NormalEquations, point: Point, motion: Jet) -> tuple[np.ndarray, ...]:
    """Elongation, its rate, and force of all connections, each (P, C)."""
    dynamics, structure = equations.dynamics, equations.dynamics.structure
    e, de = (structure.elongation(dynamics.stretching(x)) for x in (motion.value, motion.rate))
    force = structure.connection_force(e, de, equations.parameters(point), motion.value[:, dynamics.hidden])
    return tuple(x.numpy() for x in (e, de, force))


def force_border(equations: NormalEquations, point: Point, noise: NoiseModel, terms: Sequence[ForceTerm]) -> np.ndarray:
    """(size, D), products of forces with the rows of the readout weights."""
    border = np.zeros((equations.layout.size, len(terms)))
    histories, distribution = force_histories(equations, terms)
    weight = equations.motion.weight(noise)
    for part, function, rows, _ in equation_columns(equations, point):
        by, weighed = np.flatnonzero(distribution[function]), weight if weight.ndim == 1 else weight[part]
        pulled = histories[part][..., by] * weighed[..., function, None]  # (I, S or 1, terms that it feels)
        alive = slice(int(rows.indices.min()), int(rows.indices.max()) + 1)  # of this window
        border[alive, by] += (rows[:, alive].T @ pulled.flatten(0, 1).numpy()) * distribution[function, by]
    return border


def force_histories(equations: NormalEquations, terms: Sequence[ForceTerm]) -> tuple[Tensor, np.ndarray]:
    """Forces as the equations are enforced, (I, S or 1, D), and how much of them every equation has, (functions, D)."""
    like, (groups, samples) = equations.target.force, equations.physics.mask.shape
    distribution = np.empty((equations.dynamics.size, len(terms)))
    # One by one: before they are averaged they take several times the room.
    histories = like.new_empty((groups, samples if equations.averages is None else 1, len(terms)))
    for d, term in enumerate(terms):
        gathered = equations.physics.gather(torch.as_tensor(term.history).to(like)[:, None])
        histories[..., d : d + 1] = equations.averaged(gathered)
        distribution[:, d] = term.distribution
    return histories, distribution


def equation_columns(equations: NormalEquations, point: Point) -> Iterator[tuple[slice, int, csr_matrix, Tensor]]:
    """Window by window, of every equation that is enforced, linearised as it is enforced.

    Yields:
        Which groups, which function's, its rows by the readout weights (I S or I, size) and by each parameter
        (I, S or 1, p).
    """
    for part in equations.windows(equations.physics):
        segments, rows = equations.physics.part(part), equations.motion.rows(equations.physics, point, part=part)
        places = equations.layout.columns(segments.feature)
        for function in torch.nonzero(equations.target.equation).flatten().tolist():
            jacobian = rows.jacobian(segments, slice(function, function + 1))[:, 0]
            by = equations.pattern.uncertain_columns(rows.parameter[:, :, function], function)
            jacobian, by = (equations.averaged(x, part) for x in (jacobian, by))
            yield part, function, sparse_rows(jacobian, places[:, function], equations.layout.size), by


def _rate(history: np.ndarray, step: float, highest: float) -> np.ndarray:
    """(P,), derivative by time of what a history (P,) has up to a frequency, Hz."""
    from scipy.fft import dct, idct

    cosines = dct(history, type=2, norm="ortho")
    cosines[int(2.0 * highest * len(history) * step) + 1 :] = 0.0
    rate: np.ndarray = np.gradient(idct(cosines, type=2, norm="ortho"), step)
    return rate
