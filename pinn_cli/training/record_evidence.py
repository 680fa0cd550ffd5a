"""How probable one record is under a noise model.

The density of a motion that white forces make: the determinant of the equations that turn the motion into forces.

What is probable is a force; of a motion it is that density times |det L|, with L the linearised equations, the motion
at the beginning being free. It is a sum over the frequencies omega that the features follow (Szegoe's limit theorem),

    log |det L| = sum of log |det(-omega^2 M + i omega C + K)|.

A damper adds T c / 2 m to it. Left out, the record is the more probable the less its structure is damped, and a
discrepancy that lets damping go is found where there is none.

Averages of a spline of even degree p over its knot intervals see omega^j as the sum over its aliases omega_k of
omega_k^j (omega / omega_k)^(p + 2): that matters in the uppermost part of the features' band.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, reverse_cuthill_mckee

from pinn_cli.network.spline import SplineNetwork
from pinn_cli.record.spectrum import occupied_band
from pinn_cli.system.quantities import FORCE
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import FeatureProjection, NoiseModel, first_output, output_features
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.normal_matrix.bordered import BorderedFactor
from pinn_cli.training.sensor_samples import SensorSamples

# Aliases of a frequency on either side: of the furthest a power of eight or more is nothing.
ALIASES = 4
# Numbers that are held at once.
NUMBERS_AT_ONCE = 1_000_000
# Losses that are about the parameters alone.
OF_PARAMETERS = ("gain", "marginal")


def seen_powers(count: int, edge: float, degree: int | None) -> np.ndarray:
    """(3, count), 1, omega and omega^2 of frequencies up to an edge (rad/s), as averages over intervals see them.

    Args:
        count: Of the frequencies: as many as the averages.
        edge: Where the features' band ends.
        degree: Of a spline whose averages they are; None where the equations hold at points.
    """
    omega = edge * (np.arange(count) + 0.5) / count
    powers = np.arange(3)[:, None]
    if degree is None:
        return np.asarray(omega**powers)
    aliases = omega + 2.0 * edge * np.arange(-ALIASES, ALIASES + 1)[:, None]
    return np.asarray((aliases ** powers[..., None] * (omega / aliases) ** (degree + 2)).sum(1))


def log_density(mass: np.ndarray, damping: np.ndarray, stiffness: np.ndarray, seen: np.ndarray) -> float:
    """Sum over frequencies of log |det(-omega^2 M + i omega C + K)|.

    Functions that feel each other are taken together: an input is felt by the motion, and does not feel it.

    Args:
        mass: (n,), of every function's second derivative in its own equation.
        damping: (n, n), row by row of the equations.
        stiffness: Likewise.
        seen: See :func:`seen_powers`.
    """
    terms = stiffness, damping, -np.diag(mass)
    coupled = csr_matrix(sum(term != 0 for term in terms))
    number, member = connected_components(coupled, connection="strong")
    total = 0.0
    for component in range(number):
        functions = np.flatnonzero(member == component)
        functions = functions[reverse_cuthill_mckee(csr_matrix(coupled[np.ix_(functions, functions)]))]
        total += _of_coupled([term[np.ix_(functions, functions)] for term in terms], seen)
    return total


def _of_coupled(terms: list[np.ndarray], seen: np.ndarray) -> float:
    """The same of functions that all feel each other, in an order in which those that do are near: by elimination."""
    size = len(terms[0])
    row, column = np.nonzero(sum(term != 0 for term in terms))
    reach = int(np.abs(row - column).max(initial=0))
    chunk = max(1, NUMBERS_AT_ONCE // (size * (2 * reach + 1)))
    total = 0.0
    for start in range(0, seen.shape[1], chunk):
        zeroth, first, second = seen[:, start : start + chunk]
        band = np.zeros((size, 2 * reach + 1, len(zeroth)), dtype=complex)
        stiffness, damping, inertia = (term[row, column][:, None] for term in terms)
        band[row, column - row + reach] = stiffness * zeroth + 1j * damping * first + inertia * second
        for i in range(size):
            for below in range(1, min(reach, size - 1 - i) + 1):
                factor = band[i + below, reach - below] / band[i, reach]
                band[i + below, reach - below + 1 : 2 * reach - below + 1] -= factor * band[i, reach + 1 :]
        total += float(np.log(np.abs(band[:, reach])).sum())
    return total


@dataclass(frozen=True, eq=False)
class RecordSolution:
    """One record's part of a solution.

    Attributes:
        point: Where its motion ended.
        noise: That it was found under.
        factor: Of the Hessian there, of which all records have their share of the parameters' part.
        prior: (p, p), precision of what is believed of the record's parameters.
    """

    point: Point
    noise: NoiseModel
    factor: BorderedFactor
    prior: np.ndarray

    def drawn(self, count: int, of_mean_length: bool = False) -> list[Point]:
        """Draws from the posterior, as steps from the solution; the same ones every time.

        With ``of_mean_length`` each is as long as a draw is on average: few of them then add up to what they must.
        """
        size = self.factor.size
        normals = np.random.default_rng(0).standard_normal((size, count))
        if of_mean_length:
            normals *= np.sqrt(size) / np.linalg.norm(normals, axis=0)
        weights, parameters = self.factor.draws(normals)
        like = self.point.unknowns
        return [
            Point(*(torch.as_tensor(x).to(like) for x in drawn)) for drawn in zip(weights.T, parameters.T, strict=True)
        ]


class RecordEvidence:
    """What one record says of its motion, see :class:`pinn_cli.training.evidence.Evidence`.

    The physics residual counts as what the features can see of it, K values per DOF with a discrepancy that is white
    among them; beyond that there is nothing but the force sensors' noise.
    """

    def __init__(self, equations: NormalEquations) -> None:
        self.equations, self.problem = equations, equations.problem

    @cached_property
    def projection(self) -> FeatureProjection:
        """At the collocation points."""
        return FeatureProjection(self.equations.network, self.equations.physics)

    @cached_property
    def observer_projection(self) -> FeatureProjection:
        """At the response's samples, where it differs from :attr:`projection` if the force is held between its own."""
        return FeatureProjection(self.equations.network, self.equations.observation)

    @cached_property
    def load_cells(self) -> dict[int, SensorSamples]:
        """DOF to the load cell whose force stands in the equations of motion, and is no channel."""
        record, measured = self.problem.record, np.flatnonzero(self.equations.target.measured_force.numpy()).tolist()
        return {dof: SensorSamples(record.column(FORCE, dof), record) for dof in measured}

    @cached_property
    def sensors(self) -> dict[tuple[str, int], SensorSamples]:
        """Name of channels and number among them to the sensor that is one of them."""
        return {
            (channels.name, i): sensor
            for channels in self.equations.channels
            for i, sensor in enumerate(channels.sensors)
            if sensor is not None
        }

    @cached_property
    def input_channels(self) -> dict[tuple[str, int], SensorSamples]:
        """Those of :attr:`sensors` that measure an input."""
        return {place: sensor for place, sensor in self.sensors.items() if sensor.channel.is_input}

    @cached_property
    def load_cell_channels(self) -> dict[tuple[str, int], SensorSamples]:
        """Those of :attr:`input_channels` that are load cells."""
        return {place: sensor for place, sensor in self.input_channels.items() if sensor.channel.quantity == FORCE}

    def log_evidence(self, point: Point, noise: NoiseModel, readout_log_determinant: float) -> float:
        """The record's own part, without the parameters' prior and without their share of the Hessian."""
        losses, forces = self.equations.losses(point, noise), self.force_residuals(point, noise)
        rest = sum(value for name, value in losses.items() if name not in ("physics", "observer", *OF_PARAMETERS))
        sensors = self.log_variances(noise)
        # What is probable is a force, not the motion that it makes.
        moved = self._log_density_of_motion(point, forces.count)
        return -0.5 * (forces.misfit(noise) + rest + sensors + readout_log_determinant) + moved

    def mean_equations(self, point: Point) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mass (N,), damping and stiffness (N, N) of all functions' equations, linearised, on the record's average."""
        equations = self.equations
        pattern, tangent = equations.pattern, equations.motion.mean_tangent(equations.physics, point)
        stiffness, damping = (pattern.full(pattern.by_coordinate(x).numpy()) for x in tangent)
        return equations.dynamics.mass(equations.parameters(point)).numpy(), damping, stiffness

    def _log_density_of_motion(self, point: Point, count: int) -> float:
        """See :func:`log_density`: of the equations linearised at a motion, on the average over the record."""
        equations, network = self.equations, self.equations.network
        enforced, (mass, damping, stiffness) = equations.target.equation.numpy() > 0, self.mean_equations(point)
        kept = np.ix_(enforced, enforced)
        averaged = equations.averages is not None
        degree = network.degree if averaged and isinstance(network, SplineNetwork) else None
        seen = seen_powers(count, np.pi * network.free_intervals, degree)
        return log_density(mass[enforced], damping[kept], stiffness[kept], seen)

    def log_variances(self, noise: NoiseModel) -> float:
        """Sum over all samples of the sensors; those of an observer equation stand with the forces."""
        pairs = (
            (channels.values[channels.present], noise.response[channels.name][channels.present])
            for channels in self.equations.channels
        )
        return float(sum(2.0 * float(values @ np.log(sigma)) for values, sigma in pairs))

    def force_residuals(self, point: Point, noise: NoiseModel) -> ForceResiduals:
        """What the physics residual holds in the features' sight and beyond it."""
        equations = self.equations
        enforced = equations.target.equation.numpy()
        physics, weight = equations.motion.residual(point), equations.motion.weight(noise)
        observer = None
        if equations.observer is not None:
            residual = torch.cat([piece for _, piece in equations.observer.residuals(point)])
            observer = self.observer_projection.sum_of_squares(residual), equations.observer.weight(noise).numpy()
        left_open, unseen = np.zeros(len(enforced)), np.zeros(len(enforced))
        # A discrepancy varies within the intervals too, as far as the features follow it: that is no noise of a sensor.
        beyond = len(equations.problem.record.time) - equations.network.count if equations.refinement == 1 else 0
        if beyond > 0:
            moments = self.projection.no_moments(len(enforced))
            for part in equations.windows(equations.physics):
                forces = equations.motion.force(point, part)
                unseen += forces.square().sum((0, 1)).numpy()
                self.projection.add_moments(moments, forces, part)
            unseen -= self.projection.seen(moments)
        if equations.averages is None:
            seen, count = self.projection.sum_of_squares(physics), equations.network.count
        else:  # averages between the samples count as far as the samples tell what acts there
            trust = weight * torch.as_tensor(noise.physics_variance).to(weight)
            seen = (physics.square() * trust).sum((0, 1)).numpy()
            count = equations.averages.count
            if trust.ndim > 1:
                left_open = -torch.where(trust > 0, trust, 1.0).log().sum((0, 1)).numpy()
        return ForceResiduals(enforced, seen, np.maximum(unseen, 0.0), count, max(beyond, 0), left_open, observer)

    def followed_force(self) -> np.ndarray:
        """(N, n), the measured force as far as the features follow it; 0 where there is none."""
        equations, segments, network = self.equations, self.equations.forces, self.equations.network
        coefficients = self.projection.coefficients(equations.target.force)
        values = output_features(network, segments)[0] @ coefficients[first_output(network, segments).feature]
        return segments.scatter(values)[:, : equations.dynamics.ndof].numpy()


def occupied_share(evidence: RecordEvidence, solution: RecordSolution) -> float:
    """N_eff / K, see :func:`pinn_cli.training.steps.windows_discrepancy.widened`."""
    equations = evidence.equations
    unforced = equations.target.unforced & equations.dynamics.has_mass
    enforced = unforced if bool(unforced.any()) else equations.target.equation
    residual, step = equations.motion.residual(solution.point), 1.0 / equations.network.free_intervals
    if equations.averages is None:
        residual, step = equations.physics.scatter(residual), equations.problem.record.step / equations.refinement
    else:
        residual = equations.averages.by_interval(residual)
    return occupied_band(residual[:, enforced].numpy(), step, equations.network.free_intervals / 2.0)


@dataclass(frozen=True, eq=False)
class ForceResiduals:
    """The physics residual of every DOF, split into what the features see of it and what is out of their reach.

    Attributes:
        enforced: (n,) bool, the DOFs whose equation of motion counts.
        seen, unseen: (n,), sums of squares, N^2. Discrepancy and sensor noise make up the one, the noise of a force
            sensor alone the other.
        count, beyond: Independent values of each, for every DOF; ``beyond`` is 0 where nothing is out of reach.
        left_open: (n,), sum of the logarithms by which variances between the samples exceed those at the samples.
        observer: (n,) what the features see of the observer's residual, and its weights; None without one.
    """

    enforced: np.ndarray
    seen: np.ndarray
    unseen: np.ndarray
    count: int
    beyond: int
    left_open: np.ndarray
    observer: tuple[np.ndarray, np.ndarray] | None

    def misfit(self, noise: NoiseModel) -> float:
        """Chi^2 and log variances of what the features see, and of the force sensors' noise beyond."""
        variance, enforced = noise.physics_variance, self.enforced
        total = float((self.seen / variance + self.count * np.log(variance) + self.left_open)[enforced].sum())
        forced = np.isfinite(noise.force) & enforced & (noise.force_variance > 0)
        if self.beyond:
            sensor = noise.force_variance[forced]
            total += float((self.unseen[forced] / sensor + self.beyond * np.log(sensor)).sum())
        if self.observer is not None:
            seen, weight = self.observer
            used = weight > 0
            total += float((seen * weight)[used].sum() - self.count * np.log(weight[used]).sum())
        return total
