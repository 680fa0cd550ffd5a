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
from pinn_cli.training.evidence import Evidence, Trained, left_by_motion, model_log_evidence
from pinn_cli.training.factors.channel_at_point import weighted
from pinn_cli.training.least_squares import placed
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseLevels, NoiseModel
from pinn_cli.training.normal_matrix.bordered import ParameterFactor
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
# Of one record: its readout weights, its parameters and its levels.
End = tuple[np.ndarray, np.ndarray, NoiseModel]
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
        self.root = np.linalg.cholesky(trained.factor.corner_covariance)
        ends, told = zip(*evidence.each_record(_of_drive, trained), strict=True)
        self.ends = ends if given is None else tuple(given)
        self.unit = 1.0 / np.sqrt(2.0 * np.array(told))
        self.size = len(self.root) + len(self.ends)
        self._at, self.value = np.zeros(self.size), self._log(trained)

    def climbed(self) -> np.ndarray:
        """(q + records,), the slope at the peak of the density, or so many steps nearer to it; :attr:`last` is there.

        Steps of Broyden, Fletcher, Goldfarb and Shanno (Nocedal and Wright 2006, section 6.1) from the identity, since
        the unknowns are white but for what is integrated out; none is longer than twice the one before.
        """
        slope, bend, longest = self.slope(), np.eye(self.size), LONGEST_STEP
        for _ in range(CLIMBING_STEPS):
            step, before, from_here = self.within_bounds(slope, bend), slope, self._at
            if step @ slope < FLAT_GAIN:
                break
            step *= min(1.0, longest / np.linalg.norm(step))
            if not any(self.moved_to(from_here + share * step) for share in PARTS_OF_STEP):
                if np.array_equal(bend, np.eye(self.size)):
                    break
                bend = np.eye(self.size)
                continue
            longest = max(LONGEST_STEP, 2.0 * float(np.linalg.norm(self._at - from_here)))
            slope = self.slope()
            made, bent = self._at - from_here, before - slope
            if made @ bent > 0.0:
                known = bend @ made
                bend += np.outer(bent, bent) / (made @ bent) - np.outer(known, known) / (made @ known)
        return slope

    @property
    def far(self) -> float:
        """How far the parameters have moved, in standard deviations."""
        return float(np.linalg.norm(self._at[: len(self.root)]))

    def moved_to(self, u: np.ndarray) -> bool:
        """Whether the density is larger there, the motion solved for; then the solution is there.

        A hysteresis that creates energy is none: with forces that take it up again it explains as much as a true one.
        """
        point, noise = self._beside(self.last, u - self._at)
        if self.evidence.creates_energy(point) and not self.evidence.creates_energy(self.last.solution.point):
            return False
        trained = self.evidence.train(noise, point)
        value = -math.inf if trained is None else self._log(trained)
        if trained is None or not value > self.value:
            return False
        self.last, self.value, self._at = trained, value, u
        return True

    def within_bounds(self, slope: np.ndarray, bend: np.ndarray | None = None) -> np.ndarray:
        """(q + records,), of the steps that no bound is in the way of that which gains most.

        Args:
            slope: (q + records,), of the density's logarithm.
            bend: Minus its second derivatives; None: the identity.
        """
        q, room = len(self.root), self.evidence.equations.room_below(self.last.solution.point)
        white = np.eye(self.size)
        white[:q, :q] = np.linalg.inv(self.root)
        curved = white.T @ (np.eye(self.size) if bend is None else bend) @ white
        least = np.concatenate((room, np.full(self.size - q, -np.inf)))
        step: np.ndarray = white @ ParameterFactor(np.linalg.cholesky(curved)).solved(white.T @ slope, least)
        return step

    def slope(self, trained: Trained | None = None) -> np.ndarray:
        """(q + records,), of the density's logarithm at a solution; None: at the last one.

        Of the loss it is that of the normal equations, since the motion is the most probable one; of all else see
        :func:`log_density_beside_loss`.
        """
        at, equations, q = trained or self.last, self.evidence.equations, len(self.root)
        steps = WIDTH_OF_DIFFERENCE * np.eye(self.size)
        ends = [self._beside(at, step) for step in (0.0 * steps[0], *steps, *-steps[q:])]
        # The motion follows levels as well.
        ends[q + 1 :] = [(equations.followed(point, noise), noise) for point, noise in ends[q + 1 :]]
        split = (zip(equations.split(point), noise.records, strict=True) for point, noise in ends)
        by_record = zip(*([(*of.arrays, levels) for of, levels in parts] for parts in split), strict=True)
        told = self.evidence.each_record(log_density_beside_loss, at, self.ends, list(by_record))
        here, by_parameter, above, below = np.split(np.sum(told, axis=0), [1, q + 1, self.size + 1])
        # All that bends with the parameters is the loss, but for a little; levels bend the rest.
        slope = np.concatenate((2.0 * (by_parameter - here), above - below)) / (2.0 * WIDTH_OF_DIFFERENCE)
        slope[:q] += self.root.T @ at.factor.slope(equations.assemble(at.solution.point, at.noise))
        return np.nan_to_num(slope)

    def spread_of_levels(self) -> np.ndarray:
        """(q, records), by how much the parameters follow one standard deviation of the forces' levels, all else free.

        With parameters that are white they follow a level by the mixed second derivative. What is known of the level is
        the curvature of the density along that.
        """
        q = len(self.root)
        along, known = np.eye(self.size)[q:], self.unit**2  # no level is less certain than by a factor of e
        for i, direction in enumerate(along):
            direction[:q] = self._bent(direction)[:q]
            known[i] = max(known[i], -direction @ self._bent(direction))
        spread: np.ndarray = along[:, :q].T / np.sqrt(known)
        return spread

    def _bent(self, direction: np.ndarray) -> np.ndarray:
        """(q + records,), how the slope changes along a direction; 0 where it cannot be had."""
        ends = [self._beside(self.last, sign * direction) for sign in (WIDTH_OF_DIFFERENCE, -WIDTH_OF_DIFFERENCE)]
        found = [self.evidence.at(self.evidence.equations.followed(*end), end[1]) for end in ends]
        slopes = [self.slope(trained) for trained in found if trained is not None]
        change: np.ndarray = (slopes[0] - slopes[-1]) / (2.0 * WIDTH_OF_DIFFERENCE) if slopes else np.zeros(self.size)
        return change

    def _beside(self, trained: Trained, step: np.ndarray) -> tuple[Point, NoiseLevels]:
        """A step (q + records,) from a solution: the motion follows the parameters, and levels are larger."""
        equations, point, q = self.evidence.equations, trained.solution.point, len(self.root)
        x = point.parameters.numpy()
        moved = np.maximum(x + self.root @ step[:q], equations.lower) - x
        if moved.any():
            following = trained.factor.following(equations.members, equations.columns, moved)
            point = equations.moved(point, (following, moved))
        driven = []
        records = zip(trained.noise.records, np.exp(step[q:] * self.unit), equations.by_record, strict=True)
        for noise, factor, of_record in records:
            forces = of_record.dynamics.forces
            level = None if noise.innovation is None else factor * noise.innovation[forces]
            driven.append(noise if level is None else noise.driven_by(level, forces))
        return point, replace(trained.noise, records=tuple(driven))

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
    return _let_go(inference, density) if left @ left < NEARLY_FLAT else None


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
            best, noise = other, other.last.noise
    return best


def _settled(inference: Inference) -> Inference:
    trained = inference.solver.settled(inference.evidence, inference.trained, CORRELATION_ROUNDS)
    return replace(inference, trained=trained)


def _let_go(inference: Inference, density: MarginalDensity) -> Inference | None:
    """The same with parameters that are solved for, and that what is integrated out holds where they are.

    What is known of them is what is said with the levels of the forces integrated out as well.
    """
    evidence, trained = inference.evidence, inference.trained
    along = density.root @ density.spread_of_levels()
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


def log_density_beside_loss(
    evidence: RecordEvidence, solution: RecordSolution, end: float, ends: Sequence[End]
) -> np.ndarray:
    """(ends,), of a record's part of the density at points nearby; of the loss only what levels make of it.

    That is of the equations' part, the motion held; then of the determinants, and of what lies beyond the end.
    """
    at = [replace(solution, point=placed(evidence, *of), noise=noise) for *of, noise in ends]
    # First the losses: of the motion of one point the residuals are kept.
    told = np.array([-0.5 * evidence.equations.motion.loss(solution.point, here.noise) for here in at])
    told += [left_by_motion(evidence, here.point, here.noise) - log_density_beyond(evidence, here, end) for here in at]
    return told


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
