"""What a linear structure makes of what nobody measured: the spectra that its sensors should show.

The responses' spectra at one frequency are y = G_u w_u + G_f f + noise: unknown forces or the ground w_u, measured
forces f. With G the transfer functions, Q the power of what acts and R that of the sensors' noise, y - G_f f has the
covariance

    S = G_u Q_u G_u^H + G_f Q_f G_f^H + R

where Q_f is the noise of the load cells (Brillinger, Time Series, 1981, chapter 8).

What the spectra of a record of finite length are on average, where a resonance leaks into the lines beside it.

A line of a tapered record is the mean of the true spectrum over its neighbours: its expectation is the transform of the
covariance over the lag times that of the taper (Sykulski et al., Biometrika 106, 2019). What a measured force f makes
of a sensor leaks likewise. Taken off line by line as G f it leaves, with Q the power of f and < > that mean,

    <G Q G^H> - <G Q> G^H - G <Q G^H> + G <Q> G^H.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import torch

from pinn_cli.record.channel import Channel
from pinn_cli.record.channels import channels, record_band
from pinn_cli.record.cross_spectra import CrossSpectra, band_edges, taper
from pinn_cli.record.record import Record
from pinn_cli.record.spectrum import signal_edges
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.frequency_response import Acting, FrequencyResponse
from pinn_cli.system.parameters import MASS, ParameterVector
from pinn_cli.system.quantities import FORCE, MOTION
from pinn_cli.training.sensor_samples import SensorSamples, starting_levels

# The lowest lines hold the mean and slow drift, which the taper spreads over one line more.
LOWEST_LINES = 3
# Part of the record that the taper takes at both ends together: what resonances leak falls off steeply then.
TAPERED = 0.1
# What is left of the band: at its edge an anti-alias filter, or the forces themselves, have begun to fall off.
BELOW_EDGE = 0.9
# Lines of the least band that is worth a look.
FEWEST_LINES = 32
# The power of unknown forces is told at frequencies that grow by this factor: much more than a resonance is wide.
KNOT_RATIO = 1.6
# Lines beside the band whose leakage reaches it: that of the taper falls off steeply from 10 over its part on.
LINES_BESIDE = 200
# Samples of a record of which every resonance is so many lines wide that none leaks.
LONG = 2**17


def is_spectral(problem: Problem) -> bool:
    """Whether spectra say all that a record does of a problem's parameters: forces unknown, the structure linear.

    What acts is forces, or a ground that nobody measured, and sensors need columns without gaps, gains or delays.
    """
    inputs, structure, record = problem.inputs, problem.structure, problem.record
    beside = inputs.measures_ground or inputs.supports or inputs.loads or len(structure.memory) or record.calibrated
    plain = record.intersample == "band_limited" and record.repeats is None and not problem.priors
    return inputs.unmeasured and structure.has_linear_laws and not beside and plain


def band_lines(record: Record) -> list[int] | None:
    """Edges of the groups of lines of a record's own band, see `CrossSpectra.of_bands`; None: it holds too little."""
    sensors, frequency = channels(record), np.fft.rfftfreq(len(record.time), record.step)
    edges = np.array([signal_edges(sensor.measured, record.step)[0] for sensor in sensors])
    lowest = np.min(edges, initial=np.inf, where=np.isfinite(edges))
    first = max(LOWEST_LINES, int(np.searchsorted(frequency, lowest)))
    stop = int(np.searchsorted(frequency, BELOW_EDGE * record_band(record), side="right"))
    return band_edges(first, stop) if stop - first >= FEWEST_LINES else None


def spectra_in_band(record: Record) -> CrossSpectra[Channel] | None:
    """Of all pairs of sensors and load cells; None where the band holds too little."""
    edges = band_lines(record)
    if edges is None:
        return None
    sensors, loads = channels(record), channels(record, (FORCE,))
    return CrossSpectra.of_bands(record, sensors, loads, edges, len(sensors) + len(loads), TAPERED)


class SpectralModel:
    """Spectra of a problem's sensors as a function of its unknowns.

    The unknowns (q,) are the uncertain parameters (p,) in prior standard deviations from their prescribed values, the
    logarithm of the unknown forces' level at some frequencies (J,), what each force's differs from that (U,), the power
    that all have in common over what each has alone (1,), and the logarithm of every sensor's noise (S,).

    Args:
        problem: See :func:`is_spectral`.
        spectrum: Of its record.
    """

    def __init__(self, problem: Problem, spectrum: CrossSpectra[Channel]) -> None:
        self.problem, dynamics = problem, problem.dynamics
        self.dynamics, self.structure = dynamics, problem.structure
        nominal = {kind: values.double() for kind, values in problem.structure.parameters.items()}
        self.vector = ParameterVector(nominal, problem.uncertain)
        self.spread = self.vector.each("prior_std")
        n, sensors, loads = dynamics.ndof, spectrum.sensors, [load.dof for load in spectrum.acting]
        self.sensed = np.array([dynamics.sensing(c.quantity)[0][1].toarray()[c.dof, :n] for c in sensors])
        self.stretch = problem.structure.incidence.matrix.toarray()
        still, nothing, shapes = np.zeros(n), np.zeros(len(self.stretch)), problem.structure.shapes.matrix
        acting = [(shapes[dof], still, nothing) for dof in (*problem.inputs.forces, *loads)]
        if problem.inputs.ground:
            acting.insert(0, (still, problem.structure.with_ground, nothing))
        self.acting = Acting.of(acting, n)
        self.unknown_forces = dynamics.forces.stop - dynamics.forces.start
        felt = [c.quantity == MOTION[-1] and problem.inputs.absolute and problem.inputs.ground for c in sensors]
        self.felt_at_once = np.array(felt)[:, None] * (self.sensed @ self.acting.shaken)
        samples = [SensorSamples(sensor, problem.record) for sensor in sensors]
        self.first_noise = np.array([sample.first for sample in samples])
        self.load_noise = starting_levels(problem.record, FORCE)[loads]
        # Logarithms of frequencies, (J,), between which the logarithm of the forces' power is linear.
        first, last = spectrum.omega[0], spectrum.omega[-1]
        number = max(2, 1 + round(np.log(last / first) / np.log(KNOT_RATIO)))
        self.knots = np.linspace(np.log(first), np.log(last), number)
        self._look_at(spectrum)

    def _look_at(self, spectrum: CrossSpectra[Channel]) -> None:
        # Functions of frequency that are 1 at one knot and 0 at all others, linear in the logarithm between.
        hats = [np.interp(np.log(spectrum.omega), self.knots, unit) for unit in np.eye(len(self.knots))]
        self.spectrum, self.shape = spectrum, np.stack(hats, axis=1)
        self.sensing = spectrum.differentiation[:, :, None] * self.sensed

    def at(self, frequency: np.ndarray) -> SpectralModel:
        """The same model at other frequencies (G,), Hz; beyond the band's forces are as they are at its edges."""
        other = copy(self)
        other._look_at(replace(self.spectrum, frequency=frequency))
        return other

    @property
    def places(self) -> dict[str, slice]:
        """Where the unknowns of each kind stand."""
        sizes = {
            "parameters": len(self.spread),
            "shape": self.shape.shape[1],
            "forces": self.unknown_forces,
            "together": 1,
            "noise": len(self.first_noise),
        }
        ends = np.cumsum([0, *sizes.values()]).tolist()
        return {name: slice(*pair) for name, pair in zip(sizes, pairwise(ends), strict=True)}

    @property
    def size(self) -> int:
        """Unknowns in all, q."""
        return self.places["noise"].stop

    def start(self) -> np.ndarray:
        """(q,): prescribed parameters, forces that give the sensors their power, and the noise that spectra show."""
        x = np.zeros(self.size)
        x[self.places["noise"]] = np.log(self.first_noise)
        at_sensors = self._response(x).value + self.felt_at_once
        unit_power = np.einsum("gsf,gsf->g", at_sensors, at_sensors.conj()).real
        power = self.spectrum.power[:, : len(self.first_noise)].sum(1)
        x[self.places["shape"]] = 0.5 * np.log(np.median(power / unit_power))
        return x

    def _response(self, x: np.ndarray) -> FrequencyResponse:
        """Of the sensors to the forces (G, S, F)."""
        omega, (mass, damping, stiffness) = self.spectrum.omega, self.coefficients(x[self.places["parameters"]])
        connection = stiffness + 1j * omega[:, None] * damping
        return FrequencyResponse(omega, self.stretch, self.sensing, self.acting, mass, connection)

    def coefficients(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Masses (n,), and damping and stiffness (C,) of the connections; parameters (p,) in prior deviations."""
        values = self.vector.values(torch.as_tensor(parameters * self.spread))
        still = torch.zeros(self.dynamics.ndof, dtype=torch.float64)
        slope = self.structure.linearise(still, still, values)
        return values[MASS].numpy(), slope.damping.numpy(), slope.stiffness.numpy()

    def follow_modes(self, x: np.ndarray) -> None:
        """Take the damping of the whole to the modes of the masses and stiffnesses at the unknowns (q,)."""
        if self.structure.is_damped_as_whole:
            values = self.vector.values(torch.as_tensor(x[self.places["parameters"]] * self.spread))
            self.structure = self.structure.present({kind: value.numpy() for kind, value in values.items()})
            self.__dict__.pop("_by_parameter", None)

    @cached_property
    def _by_parameter(self) -> list[tuple[np.ndarray, ...]]:
        """What one prior standard deviation of each parameter adds to the coefficients: they are linear in it."""
        none = self.coefficients(np.zeros(len(self.spread)))
        return [
            tuple(more - without for more, without in zip(self.coefficients(unit), none, strict=True))
            for unit in np.eye(len(self.spread))
        ]

    def power(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(G, S, S) covariance of the sensors' spectra at the unknowns (q,), (G, S, L) from measured forces to them."""
        value, at_sensors, *_ = self._value(x, self._response(x))
        return value, at_sensors[:, :, self.unknown_forces :]

    def _value(self, x: np.ndarray, response: FrequencyResponse) -> tuple[np.ndarray, ...]:
        """(G, S, S) covariance; (G, S, F) the sensors' response to forces; those times levels; the common part."""
        at_sensors, places, omega = response.value + self.felt_at_once, self.places, self.spectrum.omega[:, None]
        unknown = self.shape @ x[places["shape"]][:, None] + x[places["forces"]]
        loads = np.broadcast_to(self.load_noise, (len(omega), len(self.load_noise)))
        level = np.concatenate((np.exp(unknown), loads), axis=1)
        scaled = level[:, :, None] * at_sensors.conj().transpose(0, 2, 1)  # (G, F, S)
        own_too = np.arange(scaled.shape[1]) < self.unknown_forces
        common = scaled[:, own_too].sum(1, keepdims=True)
        mixed = scaled + x[places["together"]] * own_too[:, None] * common
        weighed = level[:, :, None] * mixed
        value = at_sensors @ weighed + np.diag(np.exp(2.0 * x[places["noise"]]))
        return value, at_sensors, weighed, common

    def covariance(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Of the sensors' spectra at the unknowns (q,) (G, S, S), and its derivatives by these (q, G, S, S).

        From measured forces to the sensors (G, S, L), and its derivatives by the parameters (p, G, S, L).
        """
        response, places, omega = self._response(x), self.places, self.spectrum.omega[:, None]
        value, at_sensors, weighed, common = self._value(x, response)
        noise = np.exp(2.0 * x[places["noise"]])
        slopes = np.empty((self.size, *value.shape), dtype=complex)
        seen = slice(self.unknown_forces, None)
        seen_slopes = np.empty((len(self.spread), *at_sensors[:, :, seen].shape), dtype=complex)
        for i, (mass, damping, stiffness) in enumerate(self._by_parameter):
            moved = response.slope(mass, stiffness + 1j * omega * damping)
            product = moved @ weighed
            slopes[i], seen_slopes[i] = product + product.conj().transpose(0, 2, 1), moved[:, :, seen]
        unknown = slice(self.unknown_forces)
        by_force = at_sensors[:, :, unknown, None] * weighed[:, None, unknown]  # (G, S, U, S)
        by_force = by_force + by_force.conj().transpose(0, 3, 2, 1)
        slopes[places["shape"]] = self.shape.T[:, :, None, None] * by_force.sum(2)
        slopes[places["forces"]] = by_force.transpose(2, 0, 1, 3)
        slopes[places["together"]] = common.conj().transpose(0, 2, 1) @ common
        slopes[places["noise"]] = 0.0
        for i, variance in enumerate(noise):
            slopes[places["noise"].start + i, :, i, i] = 2.0 * variance
        return value, slopes, at_sensors[:, :, seen], seen_slopes


class ExpectedSpectra:
    """Of one record and its taper, for any model of the spectra in its band."""

    def __init__(self, model: SpectralModel) -> None:
        edges, samples = band_lines(model.problem.record), len(model.spectrum.values)
        assert edges is not None  # or there were no model
        self.edges, self.is_long, stop = edges, samples > LONG, edges[-1]
        # Two to a line: as many lags as the samples have pairs.
        half = np.arange(min(2 * (stop + LINES_BESIDE), samples) + 1)
        half[0] = 1  # what is asked at a frequency of zero has no logarithm
        self.frequency = half / (2.0 * samples * model.spectrum.step)
        self.mean = Leakage(taper(samples, TAPERED), stop)

    def __call__(self, model: SpectralModel, x: np.ndarray) -> np.ndarray:
        """(G, S, S), of the sensors' spectra less what measured forces make of them, at the unknowns (q,)."""
        if self.is_long:
            return model.power(x)[0]
        value, seen = model.at(self.frequency).power(x)
        mean, stop = self.mean, self.edges[-1]
        out = mean(value)
        if seen.shape[-1]:
            loads = np.stack([[np.interp(self.frequency, model.spectrum.frequency, y) for y in row]
                              for row in np.moveaxis(model.spectrum.of_acting, 0, 2)])  # fmt: skip
            acting, line = np.moveaxis(loads, 2, 0), seen[: 2 * stop : 2]
            back, pushed = line.conj().transpose(0, 2, 1), seen @ acting
            crossed = mean(pushed) @ back
            out += mean(pushed @ seen.conj().transpose(0, 2, 1)) - crossed - crossed.conj().transpose(0, 2, 1)
            out += line @ mean(acting) @ back
        averaged: np.ndarray = np.add.reduceat(out, self.edges[:-1], axis=0) / np.diff(self.edges)[:, None, None]
        return averaged


class Leakage:
    """From a spectrum at half lines to its mean at lines under a taper (N,), up to one."""

    def __init__(self, window: np.ndarray, stop: int) -> None:
        self.samples, self.stop = len(window), stop
        doubled = np.abs(np.fft.rfft(window, 2 * len(window))) ** 2
        self.lags = np.fft.irfft(doubled) / np.sum(window**2)

    def __call__(self, spectrum: np.ndarray) -> np.ndarray:
        """(stop, A, B) from (half lines, A, B), of which those that are not there are zero."""
        out = np.empty((self.stop, *spectrum.shape[1:]), complex)
        for i, j in np.ndindex(*spectrum.shape[1:]):
            lags = np.fft.irfft(spectrum[:, i, j], 2 * self.samples) * self.lags
            out[:, i, j] = np.fft.rfft(lags[: self.samples] + lags[self.samples :])[: self.stop]
        return out
