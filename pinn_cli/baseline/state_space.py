"""A problem as a state-space model: the state's motion from sample to sample, and what the sensors see.

The state holds all unknown functions of time, see :mod:`pinn_cli.baseline.equations`: motion, hidden forces, and what
acts and is not known, each with its equation. Everything that the equations leave out, the noise of force sensors
included, is a force e in each of them, held from sample to sample; a sensor of a highest derivative feels it at the
beginning of its step, where the force was sampled:

    x_k+1 = flow(x_k, f + e_k),      acceleration_k = (f_k + e_k - restoring force(x_k)) / m.

An unmeasured force is a Gaussian process that white noise drives, a latent force model (Hartikainen and Sarkka 2011;
Nayek, Chakraborty and Narasimhan 2019); so are forces whose sensors are in doubt.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag
from torch import Tensor

from pinn_cli.baseline.equations import Equations
from pinn_cli.baseline.linear_gaussian import LinearGaussian
from pinn_cli.record.between_samples import between_samples
from pinn_cli.record.channel import Channel
from pinn_cli.record.channels import record_band
from pinn_cli.record.steps import STEP_TIMES_RATE, substeps_needed
from pinn_cli.scheme.calibration import calibrations
from pinn_cli.scheme.problem import Problem, inputs_of
from pinn_cli.system.dynamics import Dynamics
from pinn_cli.system.functions import Jet
from pinn_cli.system.parameters import ParameterVector
from pinn_cli.system.quantities import FORCE
from pinn_cli.training.factors.channel_at_point import Feels, felt_by
from pinn_cli.training.record_scales import force_and_velocity_scale
from pinn_cli.training.sensor_samples import SensorSamples

# Prior standard deviations of what nobody has measured, in units of what the record is about: so wide that the record
# decides.
WIDE_PRIOR = 10.0
# The derivatives of a step need not be as exact as the step: off by a thousandth, passes settle as fast.
TANGENT_TIMES_RATE = 3.0 * STEP_TIMES_RATE
# Part of a step by which a sample may be off the record's times.
ON_TIME = 0.01


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
        sensors: (m,), in the order of :attr:`StateSpace.sensors`.
        forces: (L,), N, of what the equations leave out, in the order of :attr:`StateSpace.sources`: the discrepancy,
            the force that the model leaves out; then of force sensors, and of the white noise that drives what acts.
        spread: Of the uncertain parameters, in common, over their prior standard deviations.
    """

    sensors: np.ndarray
    forces: np.ndarray
    spread: float = 1.0

    @property
    def discrepancy(self) -> float:
        """Of the force that the model leaves out, N."""
        return float(self.forces[0])

    @property
    def values(self) -> np.ndarray:
        """(m + L,), of sensors and of forces."""
        return np.concatenate((self.sensors, self.forces))

    def moved(self, values: np.ndarray, spread: float) -> NoiseLevels:
        """Others, in the same order."""
        sensors, forces = np.split(values, [len(self.sensors)])
        return NoiseLevels(sensors, forces, spread)

    def with_discrepancy(self, discrepancy: float) -> NoiseLevels:
        """The same under another one."""
        return replace(self, forces=np.array([discrepancy, *self.forces[1:]]))


@dataclass(frozen=True, eq=False)
class Linearised:
    """The model's derivatives about a trajectory; deviations from it are the state of a :class:`LinearGaussian`.

    Attributes:
        residuals: (N, m + s), see :meth:`StateSpace.residuals`.
        rows: (N, m + s, columns), derivatives of observation and next state, see :class:`Equations`.
        functions: (3, N, F, columns), of the functions at the samples, see :meth:`Equations.derivatives`.
    """

    residuals: np.ndarray
    rows: np.ndarray
    functions: np.ndarray


class StateSpace:
    """A problem as a state-space model.

    Attributes:
        dynamics: Of its F functions.
        sensors: m channels.
        sources: (F, L), 1 where a noise level's white noise is in an equation.
        measured: (F,) bool, equations with a measured force, whose sensor's noise is in them.
        cells: Those sensors.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem, record = problem, problem.record
        self.step, self.inputs = record.step, inputs_of(problem.structure, record)
        self.dynamics = problem.dynamics if problem.inputs == self.inputs else Dynamics(problem.structure, self.inputs)
        # Calibrated channels, and behind them the other columns as if they were such, with nothing in doubt.
        columns = [
            record.column(q, i) for q in self.dynamics.observed for i in np.flatnonzero(record.plain(q)).tolist()
        ]
        channels = [replace(channel, index=index) for index, channel in enumerate((*record.calibrated, *columns))]
        numbers = {kind: values.numpy() for kind, values in calibrations(channels).items()}
        self.prescribed = problem.structure.parameters_like(np.empty(0)) | numbers
        self.vector = ParameterVector(self.prescribed, problem.uncertain)
        self.sensors = [
            ChannelRows.of(SensorSamples(channel, record), felt_by(channel, self.dynamics, self.vector), record.time)
            for channel in channels
        ]
        self.present = np.stack([sensor.present for sensor in self.sensors], axis=1)
        self.force_scale, self.velocity_scale = force_and_velocity_scale(problem)
        self.corner = 2.0 * np.pi * record_band(record)
        self.measured = np.zeros(self.dynamics.size, dtype=bool)
        if not self.dynamics.structure.is_modal and not self.inputs.loads:  # otherwise they are functions
            self.measured[: record.ndof] = record.sensors(FORCE)
        self.cells = [SensorSamples(record.column(FORCE, int(dof)), record) for dof in np.flatnonzero(self.measured)]
        self.sources = self._sources()
        equations = self.equations(self.prescribed)
        self.size, self.second = equations.size, equations.second
        self.force = np.zeros((len(record.time), self.dynamics.size))
        self.force[:, self.measured] = record.force[:, np.flatnonzero(self.measured)]
        self.between, self.roughly_between = map(self._force_within, (STEP_TIMES_RATE, TANGENT_TIMES_RATE))

    def _force_within(self, step_times_rate: float) -> np.ndarray:
        """(2 substeps + 1, N - 1, F), N, measured forces at ends and middles of substeps; 0 where unknown."""
        edge = 0.0 if self.dynamics.is_plain else self.corner  # up to which processes reach
        of_structure = substeps_needed(self.problem.structure, self.step, step_times_rate)
        substeps = max(of_structure, math.ceil(self.step * edge / step_times_rate))
        force = between_samples(self.problem.record.time, self.force, self.problem.record.intersample)
        return force.within(np.arange(2 * substeps + 1) / (2 * substeps))

    def _sources(self) -> np.ndarray:
        functions, dynamics = np.eye(self.dynamics.size), self.dynamics
        driven = np.zeros(dynamics.size, dtype=bool)
        driven[dynamics.smooth], driven[dynamics.forces] = True, True
        together = functions[:, dynamics.forces].sum(axis=1, keepdims=True)  # few sensors tell them apart
        blocks = [functions[:, self.measured], functions[:, dynamics.smooth], together[:, : len(self.inputs.forces)]]
        return np.concatenate((~driven[:, None], *blocks), axis=1)

    def first_levels(self) -> NoiseLevels:
        """Where the noise levels start.

        What the sensors' spectra show of their noise; a discrepancy as large as the force that acts; what drives a
        process such that it is as large as what the record is about.
        """
        innovation = self.scales * np.sqrt(4.0 / (self.step * self.inputs.edge))
        processes = [*innovation[self.dynamics.smooth], *(WIDE_PRIOR * innovation[self.dynamics.forces][:1])]
        forces = [self.force_scale, *(cell.first for cell in self.cells), *processes]
        return NoiseLevels(np.array([sensor.samples.first for sensor in self.sensors]), np.array(forces))

    @cached_property
    def finest(self) -> np.ndarray:
        """(m + L,), the least levels that are looked for."""
        sensors, cells = (
            [samples.finest for samples in group] for group in ([s.samples for s in self.sensors], self.cells)
        )
        return np.pad([*sensors, 0.0, *cells], (0, self.sources.shape[1] - 1 - len(cells)))

    @property
    def held(self) -> np.ndarray:
        """(m + L,) bool, levels that are not looked for: of repeated measurements, and of unmeasured forces."""
        repeated, smooth = self.problem.record.repeats is not None, self.dynamics.smooth
        of_forces = [False, *[repeated] * len(self.cells), *[False] * (smooth.stop - smooth.start)]
        of_forces += [True] * (self.sources.shape[1] - len(of_forces))
        return np.array([*(sensor.samples.scatter is not None for sensor in self.sensors), *of_forces])

    @cached_property
    def shown(self) -> np.ndarray:
        """(m + L,), noise that spectra show above their bands where that tells more than the motion; elsewhere 0.

        What a load cell shows there moves nothing. And the process of an unknown force reaches beyond its band,
        where it would take all noise for itself.
        """
        of_sensors = [
            sensor.samples.shown if self.inputs.forces or sensor.channel.quantity == FORCE else 0.0
            for sensor in self.sensors
        ]
        shown = [*of_sensors, 0.0, *(cell.shown for cell in self.cells)]
        return np.pad(shown, (0, self.sources.shape[1] - 1 - len(self.cells)))

    @cached_property
    def scales(self) -> np.ndarray:
        """(F,), how large hidden forces and what acts may be: as the sensor that feels it, or the force that acts."""
        scales = np.full(self.dynamics.size, self.force_scale)
        for sensor in self.sensors:
            if len(parts := getattr(sensor.feels, "terms", [])) == 1:
                scales[parts[0].function] = sensor.samples.spread / (self.corner / 2.0) ** parts[0].order
        return scales

    def start(self) -> Trajectory:
        """At rest, with the prescribed parameters."""
        return Trajectory(np.zeros((len(self.problem.record.time), self.size)), np.zeros(len(self.problem.uncertain)))

    def parameters(self, trajectory: Trajectory) -> dict[str, np.ndarray]:
        """Every parameter by kind, those of sensors included."""
        return self.vector.values(self.vector.each("prior_std") * trajectory.parameters)

    def equations(self, parameters: dict[str, np.ndarray]) -> Equations:
        """Under some parameters."""
        return Equations(self.dynamics, self.vector, parameters)

    def follow_modes(self, trajectory: Trajectory) -> None:
        """Take damping of the whole to the modes of the trajectory's masses and stiffnesses."""
        self.problem = self.problem.present(self.parameters(trajectory))
        self.dynamics = replace(self.dynamics, structure=self.problem.structure)

    def kinds(self, states: np.ndarray) -> list[np.ndarray]:
        """Displacements, velocities, and every other function and its rate, each by itself, of states (N, s)."""
        n, functions = self.dynamics.ndof, self.dynamics.size
        motion = [states[:, :n], states[:, functions : functions + n]]
        return [*motion, *states[:, n:functions].T, *states[:, functions + n :].T]

    def residuals(self, trajectory: Trajectory) -> np.ndarray:
        """(N, m + s): observations minus predictions, and each next state minus where the model takes the last."""
        equations, m = self.equations(self.parameters(trajectory)), len(self.sensors)
        jet = equations.jet(trajectory.states, self.force)
        residuals = np.zeros((len(trajectory.states), m + self.size))
        for row, sensor in enumerate(self.sensors):
            residuals[:, row] = sensor.residual(jet, equations.parameters)
        residuals[:-1, m:] = trajectory.states[1:] - equations.moved(trajectory.states[:-1], self.between, self.step)
        return residuals

    def linearise(self, trajectory: Trajectory) -> Linearised:
        """Derivatives of the model about a trajectory."""
        equations, m = self.equations(self.parameters(trajectory)), len(self.sensors)
        jet = equations.jet(trajectory.states, self.force)
        by, rows = equations.derivatives(jet), np.zeros((len(trajectory.states), m + self.size, equations.columns))
        for row, sensor in enumerate(self.sensors):
            rows[:, row] = sensor.rows(jet, by, equations)
        rows[:-1, m:] = equations.tangents(trajectory.states[:-1], self.roughly_between, self.step)
        return Linearised(self.residuals(trajectory), rows, by)

    def model(self, linearised: Linearised, levels: NoiseLevels) -> LinearGaussian:
        """Deviations from the trajectory under given noise levels.

        Its coefficients are changes of the uncertain parameters, then of the state at the beginning, in prior standard
        deviations; their prior is left to the caller.
        """
        m, s = len(self.sensors), self.size
        variance = self.noise_of_levels @ levels.values**2
        state, disturbance, coefficient = np.split(linearised.rows, [s, s + self.dynamics.size], axis=2)
        observed, offset = linearised.residuals[:, :m], -linearised.residuals
        offset[:, :m] = 0.0
        return LinearGaussian(
            observed,
            offset,
            state,
            disturbance,
            np.pad(coefficient, ((0, 0), (0, 0), (0, s))),
            variance[m + s :],
            np.diag(variance[: m + s]),
            np.concatenate((np.zeros((s, coefficient.shape[2])), self.beginning), axis=1),
        )

    @cached_property
    def noise_of_levels(self) -> np.ndarray:
        """(m + s + F, m + L), variance of every observation, of the next state and of the forces by that of a level.

        White force has a mean over the step, e, and varies about it: h^3/3 - h^3/4 of a value per mass squared.
        """
        within, mass = np.zeros((self.size, self.dynamics.size)), self.equations(self.prescribed).mass
        within[self.second, self.second] = self.step**4 / 12.0 / mass[self.second] ** 2
        return block_diag(np.eye(len(self.sensors)), np.concatenate((within, np.eye(len(mass)))) @ self.sources)

    def coefficients(self, trajectory: Trajectory) -> np.ndarray:
        """(p + s,), where parameters and start are, from their prior means, in prior standard deviations."""
        return np.concatenate((trajectory.parameters, np.linalg.solve(self.beginning, trajectory.states[0])))

    @cached_property
    def beginning(self) -> np.ndarray:
        """(s, s), the first state by independent numbers of deviation 1: wide unless the structure was at rest.

        Elongations rather than displacements are independent: otherwise the far end of a long chain could begin with
        connections stretched far beyond anything that the force can do.
        """
        n, functions, given = self.dynamics.ndof, self.dynamics.size, self.problem.initial_deviation
        rated = np.searchsorted(self.second, np.arange(n))
        values, rates = np.diag(WIDE_PRIOR * self.scales), np.diag(WIDE_PRIOR * self.corner * self.scales[self.second])
        if given is None:
            stiffness = self.prescribed["k"][self.prescribed["k"] > 0]
            static = self.force_scale / stiffness.min() if len(stiffness) else 0.0
            displacement = max(static, self.velocity_scale / self.corner)
            given = WIDE_PRIOR * displacement, WIDE_PRIOR * max(self.velocity_scale, displacement * self.corner)
        shape = np.linalg.inv(self.stretch).T  # from elongations to coordinates
        values[:n, :n] = given[0] * shape
        rates[np.ix_(rated, rated)] = given[1] * shape
        out = np.zeros((self.size, self.size))
        out[:functions, :functions], out[functions:, functions:] = values, rates
        return out

    @cached_property
    def stretch(self) -> np.ndarray:
        """(n, n), from coordinates to as many elongations; where a structure has more, the coordinates themselves."""
        structure, n = self.problem.structure, self.dynamics.ndof
        pull = structure.incidence.matrix[structure.added].toarray().T
        return pull if pull.shape[1] == n and np.linalg.matrix_rank(pull) == n else np.eye(n)


@dataclass(frozen=True, eq=False)
class ChannelRows:
    """One channel: gain times what it feels, an offset and a drift.

    Attributes:
        channel: Which.
        samples: Its noise by itself.
        feels: What it feels of the functions of time.
        shown: (N,), what it shows; 0 where it has no sample.
        present: (N,) bool, where it has one.
        since: (N,), time from which its drift counts, s.
    """

    channel: Channel
    samples: SensorSamples
    feels: Feels
    shown: np.ndarray
    present: np.ndarray
    since: np.ndarray

    @classmethod
    def of(cls, samples: SensorSamples, feels: Feels, time: np.ndarray) -> ChannelRows:
        """Of a channel that the smoother takes, at the record's times (N,), s."""
        channel = samples.channel
        place, off = channel.places(time)
        shown, present = np.zeros(len(time)), np.zeros(len(time), dtype=bool)
        late = channel.number("delay").value
        if np.abs(off).max() > ON_TIME:  # it misses no sample, and a spline through them tells what it shows between
            shown[:] = channel.history(time, {"gain": 1.0, "offset": 0.0, "drift": 0.0})
            present[:] = (time + late >= channel.time[0]) & (time + late <= channel.time[-1])
        else:
            inside = (place >= 0) & (place < len(time))
            shown[place[inside]], present[place[inside]] = channel.measured[inside], True
        return cls(channel, samples, feels, np.where(present, shown, 0.0), present, time + late - channel.start)

    def residual(self, jet: Jet, parameters: Mapping[str, Tensor]) -> np.ndarray:
        """(N,), what it shows minus what it would show of functions (N, F); 0 where it has no sample."""
        gain, offset, drift = (float(parameters[kind][self.channel.index]) for kind in ("gain", "offset", "drift"))
        measurand = self.feels.value(jet, parameters).numpy()
        residual: np.ndarray = self.shown - (gain * measurand + offset + drift * self.since)
        return residual * self.present

    def rows(self, jet: Jet, by: np.ndarray, equations: Equations) -> np.ndarray:
        """(N, columns), derivatives of what it shows. A row of zeros, of a sample that is not there, tells nothing.

        ``jet`` has functions (N, F), and ``by`` their derivatives, see :meth:`Equations.derivatives`.
        """
        parameters, vector = equations.parameters, equations.vector
        gain, out = float(parameters["gain"][self.channel.index]), np.zeros(by.shape[1:2] + by.shape[3:])
        parts, of_model = self.feels.linearised(jet, parameters)
        for function, order, weight in parts:
            out += gain * np.atleast_1d(weight)[:, None] * by[order][:, function]
        measurand = self.feels.value(jet, parameters).numpy()
        by_kind = {"gain": measurand, "offset": np.ones_like(measurand), "drift": self.since}
        places = zip(vector.moving, vector.column.tolist(), strict=True)
        for column, (p, place) in enumerate(places, len(out[0]) - len(vector.moving)):
            if place in of_model:
                out[:, column] += gain * p.prior_std * of_model[place].numpy()
            if p.kind in by_kind and p.index == self.channel.index:
                out[:, column] += p.prior_std * by_kind[p.kind]
        return out * self.present[:, None]
