"""What a structure does under the measured force and the ground's motion alone, and every channel against it.

Free decays are taken out of both before: how the structure began is nobody's fault. What is read off a comparison is a
factor, a delay, an offset, and what of the channel is left over.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq

from pinn_cli.record.channel import Channel
from pinn_cli.record.channels import channels
from pinn_cli.record.free_run import NoFreeRunError, affordable, free_run, is_linear
from pinn_cli.record.spectrum import mean_deviation
from pinn_cli.system.coupling import loose_dofs
from pinn_cli.system.modes import Modes, modes_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pinn_cli.record.record import Record
    from pinn_cli.record.response import Response
    from pinn_cli.system.structure import Structure

# Samples for each pole that a part of a record needs: of fewer free decays leave nothing to compare.
SAMPLES_PER_POLE = 8
# A delay is looked for up to this share of the record.
LONGEST_DELAY = 1 / 16
NEWTON_STEPS = 8


@dataclass(frozen=True, eq=False)
class Prediction:
    """A response to the measured force, and the part of the record that it is of.

    Attributes:
        response: (M, n) each; how the structure began does not matter.
        record: Its first M samples.
        modes: Of the structure without its nonlinearity, whose free decays count as part of the prediction.
    """

    response: Response
    record: Record
    modes: Modes
    _decays: dict[tuple[int, ...], np.ndarray] = field(default_factory=dict)

    def decays(self, channel: Channel) -> np.ndarray:
        """Orthonormal histories (N, p), p <= 2n: all that a free motion can put into a channel.

        Whatever the structure did before the record began lies in their span. Channels that feel the same modes, one of
        every pair, share theirs.
        """
        upper = np.flatnonzero(self.modes.poles.imag >= 0)
        shape = self.modes.shapes[channel.dof, upper]
        felt = tuple(upper[np.abs(shape) > 1e-9 * np.max(np.abs(self.modes.shapes))].tolist())
        if felt not in self._decays:
            poles, time = self.modes.poles[list(felt)], self.record.time - self.record.time[0]
            waves = np.exp(np.minimum(poles.real, 0.0) * time[:, None] + 1j * poles.imag * time[:, None])
            basis, triangle = np.linalg.qr(np.hstack([waves.real, waves.imag]))
            size = np.abs(np.diag(triangle))
            self._decays[felt] = basis[:, size > 1e-8 * np.max(size, initial=1e-300)]
        return self._decays[felt]


def predicted(structure: Structure, record: Record, start: Sequence[np.ndarray] | None = None) -> Prediction | None:
    """The free run of a structure through as much of a record as is affordable; None where it has none.

    That of a linear structure whose free motion grows is none either. Of a linear structure the start does not matter.
    """
    try:
        part = affordable(structure, record)
        prediction = prediction_of(structure, part, free_run(structure, part, start))
    except NoFreeRunError:
        return None
    too_short = prediction and part is not record and len(part.time) < SAMPLES_PER_POLE * len(prediction.modes.poles)
    return None if too_short else prediction


def prediction_of(structure: Structure, record: Record, response: Response) -> Prediction | None:
    """The same, where somebody has the free run already."""
    modes = modes_of(structure)
    # A body that nothing holds moves away, and is no less stable for it.
    grows = is_linear(structure) and not modes.stable and not loose_dofs(structure)
    return None if grows else Prediction(response, record, modes)


@dataclass(frozen=True)
class Reading:
    """A number read off a comparison.

    Attributes:
        value: In its unit.
        std: Its standard deviation, the colour of the residual allowed for.
        misfit: NMSE of the channel once it is put right.
    """

    value: float
    std: float
    misfit: float

    def differs(self, other: float, size: float, deviations: float) -> bool:
        """Whether it is off by more than ``size``, and by more than so many standard deviations."""
        distance = abs(self.value - other)
        return bool(distance > size and distance > deviations * self.std)


@dataclass(frozen=True, eq=False)
class Comparison:
    """One channel and its prediction, both without free decays.

    Attributes:
        channel: That was measured.
        measured, predicted: (M,).
        constant: (M,), a constant without what free decays can follow of it.
        power: Mean square of the channel about its mean.
        record: That the prediction is of.
    """

    channel: Channel
    measured: np.ndarray
    predicted: np.ndarray
    constant: np.ndarray
    power: float
    record: Record

    @property
    def forced(self) -> list[str]:
        """Names or numbers of the DOFs that carry a force."""
        return [self.record.dof_name(int(dof)) for dof in np.flatnonzero(~np.all(self.record.force == 0.0, axis=0))]

    @property
    def acting(self) -> str:
        """What the prediction is of, in words."""
        if self.record.ground_acceleration is None:
            return "force"
        return "ground acceleration" if not self.forced else "ground acceleration and force"

    @property
    def misfit(self) -> float:
        """NMSE: mean square of measured minus predicted over that of the channel about its mean."""
        return self._nmse(self.measured - self.predicted)

    @cached_property
    def factor(self) -> Reading:
        """Measured over predicted, by least squares."""
        lines = np.abs(self._predicted_lines) ** 2
        with np.errstate(divide="ignore", invalid="ignore"):  # of a prediction that does not move
            value = float(self.measured @ self.predicted / (self.predicted @ self.predicted))
        residual = self.measured - value * self.predicted
        return self._reading(value, lines, residual)

    @property
    def reverse_factor(self) -> float:
        """Measured over predicted where the prediction is free of error and the least-squares factor is not.

        An error of the prediction, of the force's noise for example, draws :attr:`factor` towards zero and this away
        from it; the truth lies between.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            return float(self.measured @ self.measured / (self.measured @ self.predicted))

    @cached_property
    def delay(self) -> Reading:
        """How much later the channel is than its prediction, s."""
        angular = 2 * np.pi * rfftfreq(len(self.measured), self.record.step)
        crossed = rfft(self.measured) * np.conj(self._predicted_lines)
        longest = max(4, int(LONGEST_DELAY * len(self.measured)))
        lags = np.arange(-longest, longest + 1)
        value = int(lags[np.argmax(irfft(crossed, len(self.measured))[lags])]) * self.record.step
        for _ in range(NEWTON_STEPS):
            turned = crossed * np.exp(1j * angular * value)
            curvature = float(np.sum(angular**2 * turned.real))
            if curvature <= 0:
                break
            value -= float(np.sum(angular * turned.imag)) / curvature
        moved = irfft(self._predicted_lines * np.exp(-1j * angular * value), len(self.measured))
        residual = self.measured - moved
        lines = angular**2 * np.abs(self._predicted_lines) ** 2
        return self._reading(value, lines, residual)

    @cached_property
    def offset(self) -> Reading:
        """Constant that the channel has and its prediction has not, in the channel's unit."""
        residual = self.measured - self.predicted
        if not self.constant.any():  # what is predicted is blind to a constant
            return Reading(0.0, np.inf, self._nmse(residual))
        value = float(self.constant @ residual / (self.constant @ self.constant))
        residual = residual - value * self.constant
        return Reading(value, mean_deviation(residual), self._nmse(residual))

    @cached_property
    def _predicted_lines(self) -> np.ndarray:
        return np.asarray(rfft(self.predicted))

    def _reading(self, value: float, lines: np.ndarray, residual: np.ndarray) -> Reading:
        """A least-squares coefficient; ``lines`` (K,) are the squared size of what it multiplies, by frequency."""
        weight, power = float(lines.sum()), np.abs(rfft(residual)) ** 2
        std = float(np.sqrt(np.sum(lines * power) / 2)) / weight if weight > 0 else np.inf
        return Reading(value, std, self._nmse(residual))

    def _nmse(self, residual: np.ndarray) -> float:
        return float(residual @ residual / (len(residual) * self.power))


def compare(channel: Channel, prediction: Prediction, as_dof: int | None = None) -> Comparison:
    """A channel against what is predicted for its sensor, or for the same sensor on another DOF (from 0)."""
    record = prediction.record
    place = channel if as_dof is None else replace(channel, weights={as_dof: 1.0})
    measured = channel.measured[: len(record.time)]
    basis = prediction.decays(place)
    columns = np.column_stack((measured, place.of(prediction.response), np.ones(len(measured))))
    columns = columns - basis @ (basis.T @ columns)
    power = max(float(np.var(measured)), np.finfo(float).tiny)
    projected, expected, constant = (np.ascontiguousarray(column) for column in columns.T)
    return Comparison(channel, projected, expected, constant, power, record)


def comparisons(prediction: Prediction, excused: Sequence[str] = ()) -> list[Comparison]:
    """Every channel of the record but the excused ones, by name, against its own prediction."""
    return [compare(channel, prediction) for channel in channels(prediction.record, excused=excused)]


def worst_misfit(prediction: Prediction | None, excused: Sequence[str] = ()) -> float:
    """The largest NMSE of any channel but the excused ones; infinite without a prediction."""
    misfits = [] if prediction is None else [c.misfit for c in comparisons(prediction, excused)]
    return max(misfits) if misfits and np.isfinite(misfits).all() else np.inf
