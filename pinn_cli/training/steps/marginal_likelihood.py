"""The most probable parameters under forces that nobody measured, with the motion and the forces integrated out.

Of a linear structure Whittle's likelihood has them. Of another one they are the peak of Laplace's approximation,

    log p = -1/2 [chi^2 + sum of log variances + log det H - log det P],

with the motion at its most probable one, H its Hessian and P that of the equations alone (Tierney and Kadane 1986). The
most probable motion, forces and parameters together are something else, and may lie anywhere: forces follow wrong
parameters. So here the parameters are held, and moved by this density alone, together with how large the forces are,
of which it is a ridge: with less damping, smaller forces make the same motion. What the model leaves out, the sensors'
noise and the colour of the forces take turns with them.

What frequencies beyond the end of the forces say is taken back. Unknown forces are processes that go on above the band
where forces act. That a sensor shows next to nothing up there would tell of a structure that passes nothing on: of 16
records of cubic storeys in a wind that ends below the record's band, stiffnesses came out up to 5 standard deviations
too small. Counted up to the end alone, they are as far off as they should be.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pinn_cli.system.quantities import MOTION
from pinn_cli.training.evidence import Evidence, Trained, model_log_evidence
from pinn_cli.training.factors.channel_at_point import weighted
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseLevels
from pinn_cli.training.record_evidence import RecordEvidence, RecordSolution
from pinn_cli.training.solver import Inference
from pinn_cli.training.steps.discrepancy_search import NEGLIGIBLE_GAIN, SCAN_FACTOR, negligible
from pinn_cli.training.steps.force_spectrum import drive_in_record
from pinn_cli.training.steps.unknown_forces import CORRELATION_ROUNDS, fit_force_spectrum, set_force_level

# Differences reach so far, in standard deviations; a round that moves all by less has its peak.
WIDTH_OF_DIFFERENCE, NEGLIGIBLE_MOVE = 0.2, 0.3
# Steps of a round at most, the longest first one, in deviations, parts of it that are tried, and a gain that is worth
# no further one.
CLIMBING_STEPS, LONGEST_STEP, PARTS_OF_STEP, FLAT_GAIN = 6, 3.0, (1.0, 0.3, 0.1, 0.03), 0.3
# Slopes whose squares add up to no more are those of a peak on which the motion turns round now here, now there.
NEARLY_FLAT = 4.0
# Frequencies at most at which what lies beyond the end is looked at: a resonance there must be among them.
FREQUENCIES_BEYOND = 1024


class MarginalDensity:
    """The logarithm of that density, beside a solution whose parameters are held.

    Unknowns u (q + records,) are steps of the parameters of the structure in which what the solution says of them is
    white with a unit variance, and the logarithm of how large the forces of each record are, in standard deviations.

    Args:
        evidence: Of the problem.
        trained: The solution.
        given: Where the forces of every record end, Hz; None: where the solution says.
    """

    def __init__(self, evidence: Evidence, trained: Trained, given: Sequence[float] | None = None) -> None:
        self.evidence, self.last = evidence, trained
        self.start, self.noise = trained.solution.point.parameters.numpy().copy(), trained.noise
        self.root = np.linalg.cholesky(trained.factor.corner_covariance)
        ends, told = zip(*evidence.each_record(_of_drive, trained), strict=True)
        self.ends = ends if given is None else tuple(given)
        self.unit = 1.0 / np.sqrt(2.0 * np.array(told))
        self.size = len(self.start) + len(self.ends)
        self._at, self.value = np.zeros(self.size), self._log(trained)

    def climbed(self) -> np.ndarray:
        """(q + records,), the slope at the peak of the density, or so many steps nearer to it; :attr:`last` is there.

        Steps of Broyden, Fletcher, Goldfarb and Shanno (Nocedal and Wright 2006, section 6.1) from the identity, since
        the unknowns are white but for what is integrated out; none is longer than twice the one before.
        """
        slope, inverse, longest = self.slope(), np.eye(self.size), LONGEST_STEP
        for _ in range(CLIMBING_STEPS):
            step, before, from_here = inverse @ slope, slope, self._at
            if step @ slope < FLAT_GAIN:
                break
            step *= min(1.0, longest / np.linalg.norm(step))
            if not any(self.moved_to(from_here + share * step) for share in PARTS_OF_STEP):
                if np.array_equal(inverse, np.eye(self.size)):
                    break
                inverse = np.eye(self.size)
                continue
            longest = max(LONGEST_STEP, 2.0 * float(np.linalg.norm(self._at - from_here)))
            slope = self.slope()
            made, bent = self._at - from_here, before - slope
            if made @ bent > 0.0:
                turned = np.eye(self.size) - np.outer(made, bent) / (made @ bent)
                inverse = turned @ inverse @ turned.T + np.outer(made, made) / (made @ bent)
        return slope

    @property
    def far(self) -> float:
        """How far the parameters have moved, in standard deviations."""
        return float(np.linalg.norm(self._at[: len(self.start)]))

    def moved_to(self, u: np.ndarray) -> bool:
        """Whether the density is larger there, the motion solved for; then the solution is there.

        A hysteresis that creates energy is none: with forces that take it up again it explains as much as a true one.
        """
        point = self._followed(self._parameters(u))
        if self.evidence.creates_energy(point) and not self.evidence.creates_energy(self.last.solution.point):
            return False
        trained = self.evidence.train(self._levels(u), point)
        value = -math.inf if trained is None else self._log(trained)
        if trained is None or not value > self.value:
            return False
        self.last, self.value, self._at = trained, value, u
        return True

    def slope(self) -> np.ndarray:
        """(q + records,), of the density's logarithm at the solution."""
        return self._slope(np.zeros(self.size), self.size)

    def within_bounds(self, slope: np.ndarray) -> np.ndarray:
        """(q + records,), what a slope is along the bounds beyond which it leads."""
        q, x = len(self.start), self.last.solution.point.parameters.numpy()
        by_parameter = np.linalg.solve(self.root.T, slope[:q])
        by_parameter[(x <= self.evidence.equations.lower) & (by_parameter < 0.0)] = 0.0
        return np.concatenate((self.root.T @ by_parameter, slope[q:]))

    def _slope(self, beside: np.ndarray, number: int) -> np.ndarray:
        """(number,), by as many of the unknowns at a step from the solution, by central differences."""
        steps = WIDTH_OF_DIFFERENCE * np.eye(self.size)[:number]
        above, below = ([self._nearby(self._at + beside + sign * step) for step in steps] for sign in (1.0, -1.0))
        slope: np.ndarray = np.nan_to_num((np.array(above) - np.array(below)) / (2.0 * WIDTH_OF_DIFFERENCE))
        return slope

    def spread_of_levels(self, slope: np.ndarray) -> np.ndarray:
        """(q, records), by how much the parameters follow one standard deviation of the forces' levels, all else free.

        With parameters that are white they follow a level by the mixed second derivative. What is known of the level is
        the curvature of the density along that. The slope (q + records,) is that at the solution.
        """
        q, steps, bent = len(self.start), WIDTH_OF_DIFFERENCE * np.eye(self.size), []
        along = np.eye(self.size)[q:]
        for direction, level in zip(along, steps[q:], strict=True):
            direction[:q] = (self._slope(level, q) - slope[:q]) / WIDTH_OF_DIFFERENCE
            # All four with the step of the motion that follows levels: what it gains by itself is in none alone.
            far, near = (
                sum(self._nearby(self._at + sign * width * direction) for sign in (1.0, -1.0))
                for width in (2.0 * WIDTH_OF_DIFFERENCE, WIDTH_OF_DIFFERENCE)
            )
            bent.append(np.nan_to_num(near - far) / (3.0 * WIDTH_OF_DIFFERENCE**2))
        # No level is less certain than by a factor of e.
        spread: np.ndarray = along[:, :q].T / np.sqrt(np.maximum(bent, self.unit**2))
        return spread

    def _nearby(self, u: np.ndarray) -> float:
        """The logarithm of the density; NaN where it cannot be had.

        The motion follows the parameters to first order, and by a step of its own where that is of use: under stiff
        physics it is, about corners of a law it is not.
        """
        noise, equations = self._levels(u), self.evidence.equations
        point = self._followed(self._parameters(u))
        loss, changed = self._loss(point, noise), u[len(self.start) :] != self._at[len(self.start) :]
        if changed.any() or loss > self.last.solution.loss + NEGLIGIBLE_GAIN:
            again = equations.followed(point, noise)
            point = again if self._loss(again, noise) < loss else point
        trained = self.evidence.at(point, noise)
        return math.nan if trained is None else self._log(trained)

    def _loss(self, point: Point, noise: NoiseLevels) -> float:
        return sum(self.evidence.equations.losses(point, noise).values())

    def _parameters(self, u: np.ndarray) -> np.ndarray:
        x: np.ndarray = self.start + self.root @ u[: len(self.start)]
        return np.maximum(x, self.evidence.equations.lower)

    def _levels(self, u: np.ndarray) -> NoiseLevels:
        factors = np.exp(u[len(self.start) :] * self.unit)
        records = zip(self.noise.records, factors, self.evidence.equations.by_record, strict=True)
        driven = []
        for noise, factor, equations in records:
            forces = equations.dynamics.forces
            level = None if noise.innovation is None else factor * noise.innovation[forces]
            driven.append(noise if level is None else noise.driven_by(level, forces))
        return replace(self.noise, records=tuple(driven))

    def _followed(self, x: np.ndarray) -> Point:
        """The last solution with these parameters (p,), the motion following them."""
        last, equations = self.last, self.evidence.equations
        point = last.solution.point
        step = x - point.parameters.numpy()
        if not step.any():
            return point
        following = last.factor.following(equations.members, equations.columns, step)
        return equations.moved(point, (following, step))

    def _log(self, trained: Trained) -> float:
        beyond = self.evidence.each_record(log_density_beyond, trained, self.ends)
        together = model_log_evidence(self.evidence, trained)
        return together + 0.5 * trained.factor.parameter_log_determinant - sum(beyond)


def most_probable_parameters(inference: Inference) -> Inference | None:
    """The solution with parameters nearer to the peak of that density, held; at the peak, let go. None: none is better.

    Levels and the colour of the forces follow the parameters first, where these have moved.
    """
    if not inference.evidence.equations.uncertain:
        return replace(inference, at_marginal_peak=True)
    inference = fit_force_spectrum(inference) or _settled(inference)
    density = under_another_discrepancy(inference)
    if density is None:
        return None
    slope = density.climbed()
    # What is found of wrong parameters is no end; once they have moved it is, and no later one lies above it.
    ends = density.ends if inference.ends else len(density.ends) * (math.inf,)
    inference = replace(inference, trained=density.last, ends=ends)
    if density.far > NEGLIGIBLE_MOVE:
        return inference
    left = density.within_bounds(slope)
    return _let_go(inference, density, slope) if left @ left < NEARLY_FLAT else None


def under_another_discrepancy(inference: Inference) -> MarginalDensity | None:
    """The density where what the model leaves out is as large as it is most probable, and the forces with it.

    Both push alike, so that levels in turns come to rest wherever: under the true parameters of a hysteretic storey a
    half of its wind was left out, and the record was exp(190) times as probable without.
    """
    evidence, noise = inference.evidence, replace(inference.trained.noise, held=True)
    trained = evidence.train(noise, inference.trained.solution.point)
    if trained is None:
        return None
    best = MarginalDensity(evidence, trained)
    if any(end < now for end, now in zip(inference.ends, best.ends, strict=False)):
        best = MarginalDensity(evidence, trained, list(map(min, inference.ends, best.ends)))
    least = min(map(negligible, evidence.equations.by_record, noise.records))
    for factor in (1.0, 1.0 / SCAN_FACTOR, SCAN_FACTOR):
        while noise.discrepancy * factor > least:
            again = evidence.train(noise.with_discrepancy(factor * noise.discrepancy), best.last.solution.point)
            told = again and set_force_level(replace(inference, trained=again))
            other = told and MarginalDensity(evidence, told.trained, best.ends)
            if not other or not other.value > best.value + NEGLIGIBLE_GAIN:
                break
            best, noise = other, other.noise
    return best


def _settled(inference: Inference) -> Inference:
    trained = inference.solver.settled(inference.evidence, inference.trained, CORRELATION_ROUNDS)
    return replace(inference, trained=trained)


def _let_go(inference: Inference, density: MarginalDensity, slope: np.ndarray) -> Inference | None:
    """The same with parameters that are solved for, and that what is integrated out holds where they are.

    What is known of them is what is said with the levels of the forces integrated out as well.
    """
    evidence, trained = inference.evidence, inference.trained
    along = density.root @ density.spread_of_levels(slope)
    noise, point = replace(trained.noise, held=False), trained.solution.point
    system = evidence.equations.assemble(point, noise)
    columns = evidence.equations.columns
    pull = -trained.factor.slope(system) / np.bincount(np.concatenate(columns), minlength=len(along))
    evidence.each_record(pulled, trained, [pull[places] for places in columns])
    again = evidence.train(noise, point)
    if again is None:
        return None
    schur = np.linalg.cholesky(np.linalg.inv(again.factor.corner_covariance + along @ along.T))
    return replace(inference, trained=replace(again, factor=replace(again.factor, schur=schur)), at_marginal_peak=True)


def pulled(evidence: RecordEvidence, solution: RecordSolution, pull: np.ndarray | None) -> None:
    """Let it pull at the parameters of one record from now on; None: nothing does."""
    evidence.equations.pull, evidence.equations.pulled_from = pull, solution.point.parameters


def _of_drive(evidence: RecordEvidence, solution: RecordSolution) -> tuple[float, float]:
    """Where the forces end, Hz, and how many values of what drives them are told up to there."""
    seen = drive_in_record(evidence, solution)
    if seen is None:
        return math.inf, 1.0
    end = min(evidence.problem.inputs.edge / (2.0 * np.pi), seen.end)
    return end, max(float(seen.up_to(end).determined.sum()), 1.0)


def log_density_beyond(evidence: RecordEvidence, solution: RecordSolution, end: float) -> float:
    """Whittle's log likelihood of sensors that show their noise alone from a frequency (Hz) on; 0 where none is seen.

    Of the equations linearised at the motion, on the average over the record: -sum of log det S + tr S^-1 R, with R the
    noise and S what the process of the forces makes of the sensors beside it.
    """
    equations = evidence.equations
    top = 0.5 * min(1.0 / equations.problem.record.step, equations.network.free_intervals)
    if end >= top:
        return 0.0
    dynamics, noise, record = equations.dynamics, solution.noise, equations.problem.record
    assert noise.innovation is not None
    forces = np.arange(dynamics.forces.start, dynamics.forces.stop)
    lines = (top - end) * record.step * len(record.time)
    number = min(FREQUENCIES_BEYOND, max(1, round(lines)))
    s = 2j * np.pi * (end + (top - end) * (np.arange(number) + 0.5) / number)[:, None, None]
    mass, damping, stiffness = evidence.mean_equations(solution.point)
    driven = np.zeros((dynamics.size, len(forces)))
    # White noise of the points has so much power per frequency less than that of the samples.
    driven[forces, np.arange(len(forces))] = noise.innovation[forces] / equations.refinement**0.5
    moved = np.linalg.solve(
        stiffness + s * damping + s**2 * np.diag(mass), np.broadcast_to(driven, (len(s), *driven.shape))
    )
    sensors = {place: sensor.channel for place, sensor in evidence.sensors.items() if sensor.channel.quantity in MOTION}
    rows = np.zeros((len(s), len(sensors), dynamics.size), dtype=complex)
    for i, channel in enumerate(sensors.values()):
        for function, order, weight in weighted(dynamics, channel.quantity, channel.weights):
            rows[:, i, function] += weight * s[:, 0, 0] ** order
    noise_of = np.array([noise.response[name][i] for name, i in sensors])
    shown = rows @ moved / noise_of[:, None]  # in units in which R is the identity
    spectrum = np.eye(len(sensors)) + shown @ shown.conj().transpose(0, 2, 1)
    of_noise = np.trace(np.linalg.inv(spectrum), axis1=1, axis2=2).real
    return -lines * float((np.linalg.slogdet(spectrum)[1] + of_noise).mean())
