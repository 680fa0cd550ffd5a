"""What the model may lack: how much more probable the record would be with one number more (Rao's score test).

A doubt is a parameter that the model does not have: a term of a connection, a mass that is held, or what a sensor shows
beside what it is said to feel. Its rows at the solution are a column d. With the score s = -d' r and the information x,
of both of which the motion and the parameters of the model have taken their part, its most probable value is s / x, in
prior standard deviations, and the record is exp(s^2 / 2 (1 + x)) / (1 + x)^(1/2) times as probable with it. The most
probable one is freed, and the others are asked again.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np
import torch

from pinn_cli.record.gauge import GAUGE
from pinn_cli.record.response import Response
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.functions import Jet
from pinn_cli.system.left_out import with_left_out
from pinn_cli.system.parameters import MASS, Parameter
from pinn_cli.training.band.bordered import Eliminated
from pinn_cli.training.band.discrepancy_search import Trained
from pinn_cli.training.band.evidence import Evidence
from pinn_cli.training.band.normal_equations import NormalEquations
from pinn_cli.training.band.point import Point
from pinn_cli.training.band.sensor_doubts import GAIN, HIGH_PASS, Columns, Term, sensor_columns
from pinn_cli.training.estimate import Doubt
from pinn_cli.training.noise_model import NoiseModel

# Least discrepancy over the rms force of the connections, and least noise of a sensor over the rms of the largest one
# of its kind. Stiffer equations take all but the last digits of a column's information; at a resonance of 1 % damping
# this much is half a per cent of the motion. What is smaller, far from where anything acts, is not asked.
LEAST = 1e-4
# Logarithm of how many times as probable a record must be with a doubt: among some hundred doubts, by chance once in a
# hundred records.
DECISIVE = 10.0
# Of a doubt's information, the least part that parameters leave of one that differs from them.
TOLD_APART = 1e-7
# Part of the first doubt's logarithm that a further one must have, or it may be what a linear test leaves of the first;
# and doubts that are told of one record.
BESIDE = 0.1
MOST_TOLD = 3
# Numbers of all columns together that are held at once, 0.8 GB; a larger record is not asked.
MOST_NUMBERS = 1e8


def doubts(evidence: Evidence, trained: Trained, std: Response) -> tuple[Doubt, ...]:
    """What makes a record far more probable, the most probable one first; nothing where the model holds.

    Args:
        evidence: Of one record.
        trained: Its solution.
        std: Standard deviation of the motion.
    """
    equations, point = evidence.equations, trained.solution.point
    problem = evidence.problem
    # Where nobody measured a force, it is free to be what the model lacks.
    if equations.known is not None or problem.inputs.forces or not len(problem.structure.added):
        return ()
    asked = _Asked.of(evidence, trained)
    return () if asked is None else asked.found(equations, point, std)


@dataclass(frozen=True, eq=False)
class _Asked:
    """All doubts of a record, with the readout weights eliminated.

    Attributes:
        terms: D of them.
        columns: Of them.
        eliminated: The model's own equations.
        precision: (p + D, p + D), of parameters and doubts.
        score: (p + D,).
        free: Places of the parameters that no bound holds.
    """

    terms: tuple[Term, ...]
    columns: Columns
    eliminated: Eliminated
    precision: np.ndarray
    score: np.ndarray
    free: list[int]

    @classmethod
    def of(cls, evidence: Evidence, trained: Trained) -> _Asked | None:
        """None where there is too much to hold, or the equations cannot be solved."""
        equations, point = evidence.equations, trained.solution.point
        problem, terms, force = _with_terms(evidence, trained)
        noise = _softened(evidence, trained.noise, force)
        p = len(point.parameters)
        columns = _joined(
            _connection_columns(equations, point, noise, problem, terms), sensor_columns(equations, point, noise, p)
        )
        system = equations.assemble(point, noise)
        eliminated = None if columns.border.size > MOST_NUMBERS else system.eliminated()
        if eliminated is None:
            return None
        half, taken = eliminated.readout.half_solved(np.column_stack((columns.border, system.gradient)))
        own, gradient = half[:, :-1], half[:, -1]
        across = columns.parameters - taken[:, :-1]
        precision = np.block([[eliminated.complement, across], [across.T, columns.corner - own.T @ own]])
        score = np.concatenate((taken[:, -1] - system.corner_gradient, own.T @ gradient - columns.slope))
        free = np.flatnonzero(point.parameters.cpu().numpy() > equations.lower).tolist()
        return cls(columns.terms, columns, eliminated, precision, score, free)

    @property
    def parameters(self) -> int:
        """Of the model."""
        return len(self.score) - len(self.terms)

    def found(self, equations: NormalEquations, point: Point, std: Response) -> tuple[Doubt, ...]:
        """See :func:`doubts`."""
        told: list[int] = []
        gains: list[float] = []
        while len(told) < MOST_TOLD:
            gain = self._gains(told)
            best = int(np.argmax(gain))
            if not gain[best] > max([DECISIVE, *(BESIDE * first for first in gains[:1])]):
                break
            told.append(best)
            gains.append(float(gain[best]))
        moved, name = self._moved(equations, point, std, told) if told else (0.0, "")
        return tuple(self._doubt(term, gain, told, (moved, name)) for term, gain in zip(told, gains, strict=True))

    def _gains(self, told: list[int]) -> np.ndarray:
        """(D,), logarithm of how many times as probable the record is with each doubt beside those that are told."""
        p, count = self.parameters, len(self.terms)
        score, information = self._without(self.free + [p + i for i in told], np.arange(p, p + count))
        x = np.diag(information)
        told_apart = x > TOLD_APART * np.diag(self.precision)[p:]
        x = np.maximum(x, 0.0)
        gain = 0.5 * score**2 / (1.0 + x) - 0.5 * np.log1p(x)
        # A sensor that passes more than the others do is one whose others pass less.
        wrong = np.array([term.kind == HIGH_PASS for term in self.terms]) & (score < 0.0)
        # A change that leaves no mass, or nothing of a sensor, is beyond what a linear test can tell.
        wrong |= np.isin([term.kind for term in self.terms], (MASS, GAIN)) & (score <= -(1.0 + x))
        gain[wrong | ~told_apart | np.isin(np.arange(count), told)] = -np.inf
        return gain

    def _without(self, freed: list[int], asked: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Score and information of some doubts once others, and the parameters, have taken their part."""
        solved = self._solved(freed, np.column_stack((self.score, self.precision[:, asked]))[freed])
        across = self.precision[asked][:, freed]
        return self.score[asked] - across @ solved[:, 0], (
            self.precision[np.ix_(asked, asked)] - across @ solved[:, 1:]
        )

    def _solved(self, freed: list[int], right: np.ndarray) -> np.ndarray:
        """By their precision, with the doubts' own prior."""
        matrix = self.precision[np.ix_(freed, freed)] + np.diag([float(i >= self.parameters) for i in freed])
        return np.linalg.solve(matrix, right)

    def _doubt(self, term: int, gain: float, told: list[int], moved: tuple[float, str]) -> Doubt:
        p, own = self.parameters, self.terms[term]
        others = self.free + [p + i for i in told if i != term]
        (score,), ((x,),) = self._without(others, np.array([p + term]))
        value, std = own.scale * score / (1.0 + x), own.scale / (1.0 + x) ** 0.5
        return Doubt(own.kind, own.of, float(value), float(std), own.unit, gain, *moved)

    def _moved(self, equations: NormalEquations, point: Point, std: Response, told: list[int]) -> tuple[float, str]:
        """Standard deviations by which what is reported moves if these doubts are freed, of what moves most."""
        p, count = self.parameters, len(self.terms)
        freed = self.free + [p + i for i in told]
        before, after = np.zeros((2, p + count))
        before[self.free] = self._solved(self.free, self.score[self.free])
        after[freed] = self._solved(freed, self.score[freed])
        by = (after - before)[:p]
        covariance = np.linalg.inv(self.precision[np.ix_(self.free, self.free)])
        moved = {
            equations.uncertain[i].name: abs(by[i]) / deviation**0.5
            for i, deviation in zip(self.free, np.diag(covariance), strict=True)
        }
        readout = self.eliminated.readout
        right, _ = readout.half_solved(self.columns.border @ after[p:])
        step = -readout.solved(right, by)
        along = Point(torch.as_tensor(step).to(point.unknowns), point.parameters)
        change = equations.flat_states(equations.observation, along)
        displacement = equations.dynamics.sensed("displacement", Jet(*change[:3])).cpu().numpy()
        for dof, (one, band) in enumerate(zip(displacement.T, std.displacement.T, strict=True)):
            name = f"the displacement of DOF {equations.problem.record.dof_name(dof)}"
            moved[name] = float(np.sqrt(np.mean(one**2) / np.mean(band**2)))
        furthest = max(moved, key=lambda name: moved[name])
        return float(moved[furthest]), furthest


def _softened(evidence: Evidence, noise: NoiseModel, force: float) -> NoiseModel:
    """Noise levels of which none is below `LEAST`; ``force`` is that of the connections, N, rms."""
    record = evidence.problem.record
    largest: defaultdict[str, float] = defaultdict(float)
    for quantity in noise.response.keys() - {GAUGE}:
        spread = record.histories(quantity)[:, record.sensors(quantity)].std(axis=0)
        largest[quantity] = float(np.nan_to_num(spread).max(initial=0.0))
    for gauge in record.gauges:
        largest[gauge.quantity] = max(largest[gauge.quantity], float(gauge.values.std()))
    of_gauges = np.array([largest[gauge.quantity] for gauge in record.gauges])
    response = {
        quantity: np.maximum(sigma, LEAST * (of_gauges if quantity == GAUGE else largest[quantity]))
        for quantity, sigma in noise.response.items()
    }
    softer = noise.with_discrepancy(max(noise.discrepancy, LEAST * force))
    return replace(softer, response=response)


def _joined(one: Columns, other: Columns) -> Columns:
    """Of terms that have no row in common."""
    size = len(one.terms)
    corner = np.zeros((size + len(other.terms),) * 2)
    corner[:size, :size], corner[size:, size:] = one.corner, other.corner
    border, parameters = (np.hstack((getattr(one, x), getattr(other, x))) for x in ("border", "parameters"))
    slope = np.concatenate((one.slope, other.slope))
    return Columns((*one.terms, *other.terms), border, parameters, corner, slope)


def _connection_columns(
    equations: NormalEquations, point: Point, noise: NoiseModel, problem: Problem, terms: tuple[Parameter, ...]
) -> Columns:
    """Of terms of connections and of parameters that are held, from the normal equations of a problem that has them."""
    own = point.parameters[: len(equations.problem.uncertain)]
    extended = NormalEquations(equations.network, problem, own.device.type)
    extended.ridge = equations.ridge
    system = extended.assemble(Point(point.unknowns, torch.cat((own, own.new_zeros(len(terms))))), noise)
    p, border = len(own), system.border[:, len(own) :]
    parameters = np.zeros((len(point.parameters), len(terms)))
    parameters[:p] = system.corner[:p, p:]
    return Columns(
        tuple(Term(t.title or t.kind, t.owner, t.unit, t.prior_std) for t in terms),
        border if isinstance(border, np.ndarray) else border.toarray(),
        parameters,
        system.corner[p:, p:] - np.eye(len(terms)),
        system.corner_gradient[p:],
    )


def _with_terms(evidence: Evidence, trained: Trained) -> tuple[Problem, tuple[Parameter, ...], float]:
    """The problem with terms that its connections may lack and masses that are held; those, and the rms force, N."""
    equations, problem, point = evidence.equations, evidence.problem, trained.solution.point
    structure, dynamics = problem.structure, equations.dynamics
    connections, n = structure.added, structure.coordinates
    motion = equations.flat_states(equations.observation, point)
    e, de = (structure.elongation(dynamics.stretching(x)) for x in (motion.displacement, motion.velocity))
    z = motion.displacement[:, dynamics.hidden] if len(structure.memory) else None
    force = structure.connection_force(e, de, equations.parameters(point), z)
    e, de, force = (np.maximum(np.abs(x.cpu().numpy()[:, connections]), 1e-300) for x in (e, de, force))
    doubted, terms = with_left_out(structure, connections.tolist(), _rms(de))
    size = np.concatenate([_rms(force) / _rms(e**3), _rms(force) / _rms(de**2), _rms(force)])
    terms = [replace(t, prior_std=float(s)) for t, s in zip(terms, size, strict=True)]
    if structure.shapes is None:
        held = [structure.parameter(MASS, i) for i in range(n)]
        terms += [replace(m, prior_std=m.prescribed, title="") for m in held if m not in problem.uncertain]
    freed = tuple(replace(t, unknown=True) for t in terms)
    alone = replace(problem, alternatives=(), further=(), prior=None, initial_state=None, hand_over=None)
    more = replace(alone, structure=doubted, uncertain=(*problem.uncertain, *freed))
    return more, freed, float(np.sqrt(np.mean(force**2)))


def _rms(x: np.ndarray) -> np.ndarray:
    rms: np.ndarray = np.sqrt(np.mean(x**2, axis=0))
    return rms
