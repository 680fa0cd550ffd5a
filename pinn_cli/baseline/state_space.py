"""A chain and its record as a state-space model: the state's motion from sample to sample, and what the sensors see.

The state is x = (u, v, w, dw/dt): displacement and velocity of every DOF, and the force w of those DOFs whose force
acts unmeasured. Everything that the model leaves out, the force sensor's own noise included, is a force e on every DOF,
held from sample to sample; an accelerometer feels it at the beginning of its step, where the force was sampled:

    x_k+1 = flow(x_k, f + e_k),      acceleration_k = (f_k + w_k + e_k - restoring force(u_k, v_k)) / m.

An unmeasured force is a Gaussian process with a Matern covariance of order 3/2 (a latent force model: Hartikainen and
Sarkka 2011; Nayek, Chakraborty and Narasimhan 2019): as large as its prior allows, and as fast as the record.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from pinn_cli.baseline.channels import Channel, Loads, response_channels, uncertain_numbers
from pinn_cli.baseline.discretisation import flow, propagators
from pinn_cli.baseline.linear_gaussian import LinearGaussian
from pinn_cli.record.channels import record_band
from pinn_cli.record.gauge import GAUGE
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.record.steps import substeps_needed
from pinn_cli.scheme.calibration import calibrations
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.linearisation import Linearisation
from pinn_cli.system.parameters import ParameterVector
from pinn_cli.system.quantities import CALIBRATION_UNITS
from pinn_cli.training.record_scales import force_and_velocity_scale

# Prior standard deviations of what nobody has measured, in units of what the record is about: so wide that the record
# decides.
WIDE = 10.0


@dataclass(frozen=True, eq=False)
class Trajectory:
    """What the model is linearised about.

    Attributes:
        states: (N, s).
        parameters: (p,), of the uncertain ones: distance from the prescribed value in prior standard deviations.
    """

    states: np.ndarray
    parameters: np.ndarray


@dataclass(frozen=True, eq=False)
class NoiseLevels:
    """Noise levels, as standard deviations.

    Attributes:
        response: Quantity to (n,), of its sensors; NaN where there is none. Under :data:`GAUGE` those of gauges.
        force: (n,), of the force sensors, N; NaN where there is none.
        discrepancy: Of the force that the model leaves out, on every DOF, N.
        spread: Of the uncertain parameters, in common, over their prior standard deviations.
    """

    response: dict[str, np.ndarray]
    force: np.ndarray
    discrepancy: float
    spread: float = 1.0

    def of(self, sensor: Channel) -> float:
        """Of one response sensor, in what it shows."""
        if sensor.gauge is not None:
            return float(self.response[GAUGE][sensor.gauge])
        (dof,) = sensor.weights
        return float(self.response[sensor.quantity][dof])

    @property
    def disturbance_variance(self) -> np.ndarray:
        """(n,), N^2: model error, and the noise of the force sensor where there is one."""
        return np.nan_to_num(self.force) ** 2 + self.discrepancy**2


@dataclass(frozen=True, eq=False)
class Linearised:
    """The model's derivatives about a trajectory; deviations from it are the state of a :class:`LinearGaussian`.

    Attributes:
        trajectory: Where.
        residuals: (N, m + s), see :meth:`StateSpace.residuals`.
        state, disturbance, coefficient: As there, the coefficients of the uncertain parameters only.
        by_state: (N, n, s), derivative of the accelerations.
        by_parameter: (N, n, p), likewise, by uncertain parameter in prior standard deviations.
    """

    trajectory: Trajectory
    residuals: np.ndarray
    state: np.ndarray
    disturbance: np.ndarray
    coefficient: np.ndarray
    by_state: np.ndarray
    by_parameter: np.ndarray


class StateSpace:
    """A problem as a state-space model."""

    def __init__(self, problem: Problem) -> None:
        self.problem, record = problem, problem.record
        self.n, self.step = record.ndof, record.step
        self.hidden = np.flatnonzero(~record.sensors("force") & ~record.unforced)
        self.size = 2 * (self.n + len(self.hidden))
        numbers = {kind: values.numpy() for kind, values in calibrations(record.gauges).items()}
        self.prescribed = problem.structure.parameters_like(np.empty(0)) | numbers
        self.vector = ParameterVector(self.prescribed, problem.uncertain)
        self.of_sensors = uncertain_numbers(problem.uncertain)
        self.structural = [p for p in problem.uncertain if p.kind not in CALIBRATION_UNITS]
        self.force_scale, self.velocity_scale = force_and_velocity_scale(problem)
        self.corner = 2.0 * np.pi * record_band(record)
        self.loads = Loads(record, substeps_needed(problem.structure, self.step))
        self.sensors = response_channels(record)
        self.measured = np.stack([sensor.shown for sensor in self.sensors], axis=1)
        self.there = np.stack([sensor.there for sensor in self.sensors], axis=1)

    @cached_property
    def precision(self) -> np.ndarray:
        """(p,), prior precision of the uncertain parameters: 1, but for unknown offsets and drifts of load cells.

        Accelerometers do not feel a force that stays. A force that nobody has described is taken to vary about zero: so
        its mean over the record is what chance leaves of it, and the rest of what a load cell shows is its offset.
        """
        return np.array([self.loads.precision(p, self.corner) for p in self.problem.uncertain])

    def start(self) -> Trajectory:
        """At rest, with the prescribed parameters."""
        return Trajectory(np.zeros((len(self.problem.record.time), self.size)), np.zeros(len(self.problem.uncertain)))

    def parameters(self, trajectory: Trajectory) -> dict[str, np.ndarray]:
        """Every parameter of the structure by kind."""
        return self.vector.values(self.vector.each("prior_std") * trajectory.parameters)

    def follow_modes(self, trajectory: Trajectory) -> None:
        """Take damping of the whole to the modes of the trajectory's masses and stiffnesses."""
        self.problem = self.problem.present(self.parameters(trajectory))

    def acceleration(self, trajectory: Trajectory) -> np.ndarray:
        """(N, n), at the samples, under the measured and the hidden force."""
        u, v, w, _ = self.split(trajectory.states)
        parameters = self.parameters(trajectory)
        force = self.loads.at_samples(parameters)
        force[:, self.hidden] += w
        return self.problem.structure.acceleration(u, v, force, parameters)

    def split(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Displacement (..., n), velocity (..., n), hidden force and its rate (..., hidden DOFs)."""
        ends = np.cumsum([self.n, self.n, len(self.hidden)])
        u, v, w, rate = np.split(states, ends, axis=-1)
        return u, v, w, rate

    def predicted(self, trajectory: Trajectory) -> np.ndarray:
        """(N - 1, s), where the model takes each state of the trajectory, without disturbance."""
        u, v, w, rate = self.split(trajectory.states[:-1])
        parameters = self.parameters(trajectory)

        def slope(z: np.ndarray, f: np.ndarray) -> np.ndarray:
            return np.stack((z[1], self.problem.structure.acceleration(z[0], z[1], f, parameters)))

        force = self.loads.between(parameters)
        if len(self.hidden):
            force = force.copy()
            time = np.linspace(0.0, self.step, len(force))[:, None, None]
            force[:, :, self.hidden] += np.exp(-self.corner * time) * (w + (rate + self.corner * w) * time)
        moved = flow(slope, np.stack((u, v)), force, self.step)
        latent = np.concatenate((w, rate), axis=1) @ self._latent_transition().T
        return np.concatenate((*moved, latent), axis=1)

    def _motion(self, trajectory: Trajectory) -> dict[str, np.ndarray]:
        """Quantity to its histories (N, n)."""
        histories = (*self.split(trajectory.states)[:2], self.acceleration(trajectory))
        return dict(zip(RESPONSE_QUANTITIES, histories, strict=True))

    def residuals(self, trajectory: Trajectory) -> np.ndarray:
        """(N, m + s): observations minus predictions, and each next state minus where the model takes the last."""
        motion = self._motion(trajectory)
        residuals = np.zeros((len(self.measured), len(self.sensors) + self.size))
        parameters = self.parameters(trajectory)
        for row, sensor in enumerate(self.sensors):
            gain, nothing = sensor.numbers(parameters)
            residuals[:, row] = self.measured[:, row] - (gain * sensor.felt(motion) + nothing)
        residuals[:, : len(self.sensors)] *= self.there
        residuals[:-1, len(self.sensors) :] = trajectory.states[1:] - self.predicted(trajectory)
        return residuals

    def linearise(self, trajectory: Trajectory) -> Linearised:
        """Derivatives of the model about a trajectory; within a step, those of its middle."""
        n, s, m = self.n, self.size, len(self.sensors)
        parameters = self.parameters(trajectory)
        by_state, by_parameter = self._derivatives(trajectory, parameters)
        following = np.minimum(np.arange(1, len(by_state) + 1), len(by_state) - 1)
        rates = np.zeros((len(by_state), s, s))
        rates[:, :n, n : 2 * n] = np.eye(n)
        rates[:, n : 2 * n] = (by_state + by_state[following]) / 2.0
        rates[:, 2 * n :, 2 * n :] = self._latent_rates()
        through, integral = propagators(rates, self.step, self._fastest(by_state))
        push = integral[:, :, n : 2 * n]
        state, felt = np.zeros((len(rates), m + s, s)), np.zeros((len(rates), m + s, n))
        coefficient = np.zeros((len(rates), m + s, by_parameter.shape[2]))
        state[:, m:], felt[:, m:] = through, push / parameters["m"]
        coefficient[:, m:] = push @ ((by_parameter + by_parameter[following]) / 2.0)
        motion = self._motion(trajectory)
        for row, sensor in enumerate(self.sensors):
            gain, _ = sensor.numbers(parameters)
            coefficient[:, row] = sensor.by_numbers(sensor.felt(motion), self.problem.uncertain)
            for dof, weight in sensor.weights.items():
                if sensor.quantity == "acceleration":
                    state[:, row] += gain * weight * by_state[:, dof]
                    felt[:, row, dof] = gain * weight / parameters["m"][dof]
                    coefficient[:, row] += gain * weight * by_parameter[:, dof]
                else:
                    state[:, row, dof if sensor.quantity == "displacement" else n + dof] = gain * weight
        # A row of zeros tells nothing: that is a sample that is not there.
        for rows in (state, felt, coefficient):
            rows[:, :m] *= self.there[:, :, None]
        return Linearised(trajectory, self.residuals(trajectory), state, felt, coefficient, by_state, by_parameter)

    def model(self, linearised: Linearised, levels: NoiseLevels) -> LinearGaussian:
        """Deviations from the trajectory under given noise levels.

        Its coefficients are changes of the uncertain parameters, then of the initial elongations and their rates, in
        prior standard deviations; their prior is left to the caller.
        """
        n, m, s, p = self.n, len(self.sensors), self.size, len(self.problem.uncertain)
        variance = levels.disturbance_variance
        noise = np.zeros((m + s, m + s))
        noise[range(m), range(m)] = [levels.of(sensor) ** 2 for sensor in self.sensors]
        # White force has a mean over the step, e, and varies about it: h^3/3 - h^3/4 of displacement per mass squared.
        within = range(m, m + n)
        noise[within, within] = variance * self.step**4 / 12.0 / self.prescribed["m"] ** 2
        stationary, carried = self._latent_stationary(), self._latent_transition()
        noise[m + 2 * n :, m + 2 * n :] = stationary - carried @ stationary @ carried.T
        initial, initial_covariance = np.zeros((s, 1 + p + 2 * n)), np.zeros((s, s))
        initial[2 * n :, 0] = -linearised.trajectory.states[0, 2 * n :]
        shape = np.linalg.inv(self.stretch).T  # from elongations to displacements
        initial[: 2 * n, 1 + p :] = np.kron(np.eye(2), shape) * self.initial_std
        initial_covariance[2 * n :, 2 * n :] = stationary
        coefficient = np.pad(linearised.coefficient, ((0, 0), (0, 0), (0, 2 * n)))
        observed, offset = linearised.residuals[:, :m], -linearised.residuals
        offset[:, :m] = 0.0
        return LinearGaussian(
            observed, offset, linearised.state, linearised.disturbance, coefficient, variance, noise, initial,
            initial_covariance,
        )  # fmt: skip

    def coefficients(self, trajectory: Trajectory) -> np.ndarray:
        """(p + 2 n,), where parameters and start are, from their prior means, in prior standard deviations."""
        u, v, _, _ = self.split(trajectory.states[0])
        return np.concatenate(
            (trajectory.parameters, np.concatenate((u @ self.stretch, v @ self.stretch)) / self.initial_std)
        )

    @cached_property
    def stretch(self) -> np.ndarray:
        """(n, n), from coordinates to as many elongations; where a structure has more, the coordinates themselves."""
        structure = self.problem.structure
        pull = structure.incidence.matrix[structure.added].toarray().T
        return pull if pull.shape[1] == self.n and np.linalg.matrix_rank(pull) == self.n else np.eye(self.n)

    @cached_property
    def initial_std(self) -> np.ndarray:
        """(2 n,), of the initial elongations, m, and their rates, m/s: wide unless the structure was at rest.

        Elongations rather than displacements are independent: otherwise the far end of a long chain could begin with
        connections stretched far beyond anything that the force can do.
        """
        if self.problem.initial_deviation is not None:
            return np.repeat(self.problem.initial_deviation, self.n)
        stiffness = self.prescribed["k"][self.prescribed["k"] > 0]
        static = self.force_scale / stiffness.min() if len(stiffness) else 0.0
        displacement = max(static, self.velocity_scale / self.corner)
        return WIDE * np.repeat([displacement, max(self.velocity_scale, displacement * self.corner)], self.n)

    def _derivatives(self, trajectory: Trajectory, parameters: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Of the accelerations at the samples: (N, n, s) by state and (N, n, p) by uncertain parameter."""
        u, v, _, _ = self.split(trajectory.states)
        tensors = {name: torch.as_tensor(value) for name, value in parameters.items()}
        slope = self.problem.structure.linearise(torch.as_tensor(u), torch.as_tensor(v), tensors)
        mass, pull = parameters["m"][:, None], self.problem.structure.incidence.matrix.toarray().T
        by_state = np.zeros((len(u), self.n, self.size))
        by_state[:, :, : self.n] = -(pull * slope.stiffness.numpy()[:, None]) @ pull.T / mass
        by_state[:, :, self.n : 2 * self.n] = -(pull * slope.damping.numpy()[:, None]) @ pull.T / mass
        by_state[:, self.hidden, 2 * self.n + np.arange(len(self.hidden))] = 1.0 / parameters["m"][self.hidden]
        return by_state, self._by_parameter(slope, parameters, self.acceleration(trajectory))

    def _by_parameter(
        self, slope: Linearisation, parameters: dict[str, np.ndarray], acceleration: np.ndarray
    ) -> np.ndarray:
        mass = parameters["m"]
        own = self.problem.structure.by_parameters(slope, self.structural, torch.as_tensor(acceleration)).numpy()
        out = self.loads.by_numbers(parameters, self.problem.uncertain) / mass[:, None]
        out[:, :, ~self.of_sensors] = -self.vector.each("prior_std")[~self.of_sensors] * own / mass[:, None]
        return out

    def _fastest(self, by_state: np.ndarray) -> float:
        """A bound on the eigenvalues of the linearised motion, 1/s (Gershgorin, on M^-1 K and on M^-1 C)."""
        rows = [np.abs(by_state[:, :, i * self.n : (i + 1) * self.n]).sum(axis=2).max() for i in range(2)]
        return float(max(np.sqrt(rows[0]), rows[1], self.corner))

    def _latent_rates(self) -> np.ndarray:
        one = np.array([[0.0, 1.0], [-(self.corner**2), -2.0 * self.corner]])
        return np.kron(one, np.eye(len(self.hidden)))

    def _latent_transition(self) -> np.ndarray:
        """Of (w, dw/dt), Matern 3/2: exp(-c h) [[1 + c h, h], [-c^2 h, 1 - c h]] for a corner c."""
        c, h = self.corner, self.step
        one = np.exp(-c * h) * np.array([[1.0 + c * h, h], [-c * c * h, 1.0 - c * h]])
        return np.kron(one, np.eye(len(self.hidden)))

    def _latent_stationary(self) -> np.ndarray:
        std = WIDE * self.force_scale
        return np.kron(np.diag([std**2, (self.corner * std) ** 2]), np.eye(len(self.hidden)))
