"""Noise levels: what loss weights mean, lambda = 1 / sigma^2; the levels that a training found.

Sensor noise is white, and shows in each channel beyond what the network's features can follow. Model error is a force
on every DOF, the discrepancy, as rich as the features and no richer: K independent values per DOF, however often it is
sampled.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from scipy.linalg import cho_solve_banded, cholesky_banded
from torch import Tensor

from pinn_cli.network.linear_readout import LinearReadout, Segments
from pinn_cli.record.channel import CALIBRATED, Channel
from pinn_cli.record.response import MEASURED_QUANTITIES


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Standard deviations of every residual; a loss weight is one over its square.

    Attributes:
        response: Quantity to the standard deviation of its sensors (channels,); NaN where there is none.
        force: (functions,), of the force sensors in the equations of motion; NaN where there is none.
        discrepancy: Of the force that the model leaves out, per collocation point, on every DOF, N.
        innovation: (functions,), of the white noise that drives unknown forces and the ground, per collocation point,
            NaN of all other functions; None where there are none.
        continuity: Of d(displacement)/dt - velocity, m/s, for networks with separate outputs.
        occupied: Share of the features' band that the discrepancy fills, 1 where it is taken for white.
        points_per_sample: Collocation points for every force sample: between the samples lies the noise of the samples,
            in the same band, and a point's own is so many times as large in variance.
        taken_up: (channels,), values of every calibrated channel that the motion has taken up; None: not counted yet.
            See :class:`pinn_cli.training.factors.calibrated_channels.Gains`.
        pushes: Name in ``response`` to the least that a unit of each sensor's noise puts into an equation of motion
            (channels,): of a load cell how far its DOF moves with a coordinate, of the ground the least mass that it
            moves, kg; NaN where it feels a motion.
        earlier_misfit: What earlier windows took their discrepancy for, over what all windows say of it together.
    """

    response: dict[str, np.ndarray]
    force: np.ndarray
    discrepancy: float
    continuity: float
    occupied: float = 1.0
    points_per_sample: int = 1
    innovation: np.ndarray | None = None
    taken_up: np.ndarray | None = None
    pushes: Mapping[str, np.ndarray] = field(default_factory=dict)
    earlier_misfit: float = 1.0

    def driven_by(self, level: float | np.ndarray, functions: slice) -> NoiseModel:
        """The same with some functions that white noise of this standard deviation, or of one each, drives."""
        innovation = np.full(len(self.force), np.nan) if self.innovation is None else self.innovation.copy()
        innovation[functions] = level
        return replace(self, innovation=innovation)

    def widened(self, occupied: float) -> NoiseModel:
        """The same model error in a part of the features' band: fewer independent values, and larger ones."""
        return replace(self, discrepancy=self.discrepancy / np.sqrt(occupied), occupied=occupied)

    def misfit(self, values: int, samples: int) -> float:
        """Root mean square of the force that the model leaves out, N, with ``values`` features over ``samples``."""
        return float(self.discrepancy * np.sqrt(self.occupied * values / (samples * self.points_per_sample)))

    def pooled(self) -> NoiseModel:
        """The same with one noise level for all sensors of a quantity: the root mean square of theirs."""
        return replace(self, response={q: _pooled(x) for q, x in self.response.items()}, force=_pooled(self.force))

    def noisier(self, factor: float) -> NoiseModel:
        """The same with response sensors whose noise is so many times as large."""
        return replace(self, response={quantity: factor * level for quantity, level in self.response.items()})

    def with_force_scale(self, factor: float) -> NoiseModel:
        """The same with force sensors whose noise is so many times as large."""
        return replace(self, force=self.force * factor)

    @property
    def least_of_inputs(self) -> float:
        """The least noise, N, that any measured input puts into an equation; 0 where none is measured."""
        levels = (*self.force, *(x for q, push in self.pushes.items() for x in push * self.response[q]))
        return float(min(filter(math.isfinite, levels), default=0.0))

    @property
    def physics_variance(self) -> np.ndarray:
        """(functions,) variance of the physics residual: discrepancy, and sensor noise where the force is measured.

        Of an unknown force and of the ground that of what drives them.
        """
        variance: np.ndarray = self.force_variance + self.discrepancy**2
        if self.innovation is None:
            return variance
        return np.where(self.driven, self.innovation**2, variance)

    @property
    def driven(self) -> np.ndarray:
        """(functions,) bool: the unknown forces and the ground, which white noise drives."""
        return np.zeros(len(self.force), bool) if self.innovation is None else np.isfinite(self.innovation)

    @property
    def force_variance(self) -> np.ndarray:
        """(functions,), of the force sensors among the collocation points, 0 where there is none."""
        return self.points_per_sample * np.nan_to_num(self.force) ** 2

    def sensor_weight(self, name: str) -> np.ndarray:
        """(channels,) of what sensors leave, 0 where there is none."""
        return np.nan_to_num(1.0 / self.response[name] ** 2)

    def observer_weight(self, mass: np.ndarray) -> np.ndarray:
        """(n,) of accelerations through the equation of motion, which has noise of its own; 0 where there is none."""
        variance = self.response["acceleration"] ** 2 + self.physics_variance / (self.points_per_sample * mass**2)
        return np.nan_to_num(1.0 / variance)


@dataclass(frozen=True, eq=False)
class NoiseLevels:
    """Noise levels of all records that are solved together, one as well, and how far their parameters may be off.

    Attributes:
        records: Of every record.
        spread: Prior standard deviation of the uncertain parameters, in common, over the one that was prescribed.
        firmness: Prior standard deviation of the unknown parameters over the one with which they are held at their
            start besides, on the way to a solution; 0: they are not.
        held: Whether all parameters stay where they are: only the motion is solved for.
        roughness: (curves,), of curves that nobody has a law for: prior standard deviation of the terms of each over
            the one that was given; empty: that.
    """

    records: tuple[NoiseModel, ...]
    spread: float = 1.0
    firmness: float = 0.0
    held: bool = False
    roughness: np.ndarray = field(default_factory=lambda: np.ones(0))

    def each(self, function: Callable[..., NoiseModel], *arguments: Any) -> NoiseLevels:
        """What a function makes of every record's, with the same arguments."""
        return replace(self, records=tuple(function(noise, *arguments) for noise in self.records))

    @property
    def discrepancy(self) -> float:
        """Of the first record."""
        return self.records[0].discrepancy

    def with_discrepancy(self, discrepancy: float) -> NoiseLevels:
        """The same sensors under another model error of the first record; that of the others changes by its factor."""
        factor, (first, *others) = discrepancy / self.discrepancy, self.records
        changed = (replace(noise, discrepancy=factor * noise.discrepancy) for noise in others)
        return replace(self, records=(replace(first, discrepancy=discrepancy), *changed))


def _pooled(sigma: np.ndarray) -> np.ndarray:
    present = np.isfinite(sigma)
    return np.where(present, np.sqrt(np.mean(sigma[present] ** 2)), np.nan) if present.any() else sigma


class FeatureProjection:
    """Least-squares projection of time histories onto the features of displacements, or onto their derivatives.

    Args:
        network: Whose.
        segments: Of the times.
        order: Of the derivative: 0 for forces and displacements, 2 for accelerations.
    """

    def __init__(self, network: LinearReadout, segments: Segments, order: int = 0) -> None:
        self.segments, self.features = first_output(network, segments), output_features(network, segments)[order]
        self.index, count = self.segments.feature, network.count
        gram = self.features.mT @ self.features
        span = int((self.index.amax(1) - self.index.amin(1)).max())
        row, column = self.index[:, :, None].expand_as(gram), self.index[:, None, :].expand_as(gram)
        lower = row >= column
        band = torch.zeros((span + 1) * count, dtype=gram.dtype)
        band.index_add_(0, ((row - column) * count + column)[lower], gram[lower])
        array = band.reshape(span + 1, -1).numpy()
        # Derivatives of splines are one polynomial short of independent: a touch of ridge decides among equals. It is
        # relative to each feature: those that only just reach into the record are small, and features all the same.
        array[0] *= 1.0 + 1e-10
        array[0] += 1e-15 * array[0].max()
        self.factor = cholesky_banded(array, lower=True)

    def no_moments(self, channels: int) -> Tensor:
        """(count, channels) zeros, for :meth:`add_moments`."""
        return torch.zeros(self.segments.count, channels, dtype=self.features.dtype)

    def add_moments(self, moments: Tensor, values: Tensor, part: slice = slice(None)) -> None:
        """Add the products of the features with histories (I, S, channels) of some groups."""
        local = self.features[part].mT @ values
        moments.index_add_(0, self.index[part].reshape(-1), local.reshape(-1, values.shape[-1]))

    def seen(self, moments: Tensor) -> np.ndarray:
        """(channels,), squared norm of the projection of histories, from the moments of all groups."""
        products = moments.numpy()
        return np.einsum("ki,ki->i", products, cho_solve_banded((self.factor, True), products))

    def _moments(self, values: Tensor) -> Tensor:
        moments = self.no_moments(values.shape[-1])
        self.add_moments(moments, values)
        return moments

    def sum_of_squares(self, values: Tensor) -> np.ndarray:
        """Squared norm of the projection of each DOF's grouped history (I, S, n): what the features can see of it."""
        return self.seen(self._moments(values))

    def coefficients(self, values: Tensor) -> Tensor:
        """Of the features in the projection of a history (N, n): (count, n)."""
        moments = self._moments(self.segments.gather(values))
        return torch.as_tensor(cho_solve_banded((self.factor, True), moments.numpy()))

    def residual(self, values: Tensor) -> np.ndarray:
        """(N, n) minus its projection: what the features cannot follow."""
        fitted = self.features @ self.coefficients(values)[self.index]
        return (values - self.segments.scatter(fitted)).numpy()


def first_output(network: LinearReadout, segments: Segments) -> Segments:
    """The groups of the displacement output alone, where a DOF has two outputs."""
    channels = network.channels
    return replace(segments, feature=segments.feature[:, ::channels] // channels, count=network.count)


def output_features(network: LinearReadout, segments: Segments) -> tuple[Tensor, Tensor, Tensor]:
    """Value, first and second derivative of one output's features, each (I, S, B)."""
    if network.channels == 1:
        return segments.orders
    value, rate = segments.orders[0][..., ::2], segments.orders[2][..., 1::2]
    return value, value, rate


# How levels are called in ``run.json``, before the name of what they are of.
SIGMA, DISCREPANCY, TAKEN = "sigma_", "sigma_discrepancy", "effective_parameters"


@dataclass(frozen=True, eq=False)
class FoundNoise:
    """Standard deviations.

    Attributes:
        sensors: Quantity (`CALIBRATED` of calibrated channels) to those of its sensors (C,), in the unit of what they
            feel; NaN where there is none. Empty where the training finds none.
        discrepancy: N, per sample, of the force that the model leaves out; NaN where the training has none.
        taken: Likewise of how many values of each sensor's samples the solution has taken up.
    """

    sensors: Mapping[str, np.ndarray] = field(default_factory=dict)
    discrepancy: float = math.nan
    taken: Mapping[str, np.ndarray] = field(default_factory=dict)

    @classmethod
    def read(cls, summary: Mapping[str, Any]) -> FoundNoise:
        """From what :attr:`summary` has left in ``run.json``."""
        pairs = ((name, summary.get(f"{SIGMA}{name}")) for name in (*MEASURED_QUANTITIES, CALIBRATED))
        sensors = {quantity: _numbers(values) for quantity, values in pairs if values is not None}
        taken = {quantity: _numbers(values) for quantity, values in summary.get(TAKEN, {}).items()}
        discrepancy = summary.get(DISCREPANCY)
        return cls(sensors, math.nan if discrepancy is None else discrepancy, taken)

    @property
    def summary(self) -> dict[str, Any]:
        """For ``run.json``."""
        taken = {TAKEN: {quantity: _listed(values) for quantity, values in self.taken.items()}} if self.taken else {}
        discrepancy = {} if math.isnan(self.discrepancy) else {DISCREPANCY: float(self.discrepancy)}
        return (
            taken | discrepancy | {f"{SIGMA}{quantity}": _listed(values) for quantity, values in self.sensors.items()}
        )

    def of(self, channel: Channel) -> float:
        """That of one sensor; NaN where the training found none."""
        quantity, place = channel.place
        levels = self.sensors.get(quantity, np.empty(0))
        return float(levels[place]) if place < len(levels) else math.nan


def _numbers(values: list[float | None]) -> np.ndarray:
    return np.array([math.nan if x is None else x for x in values], dtype=float)


def _listed(values: np.ndarray) -> list[float | None]:
    return [None if np.isnan(x) else float(x) for x in values]


# Weight of the user's parameter uncertainty, in parameters, when the common spread is learned from the record. With
# less, a few parameters that a record tells half draw it to zero by chance, and their intervals hold 70 to 80 %.
PRIOR_PARAMETERS = 1.0


def updated_spread(x: np.ndarray, variance: np.ndarray, spread: float) -> float:
    """How far believed parameters are off, in common, as far as the record says.

    MacKay's update of one relative variance, s^2 = (nu + sum x^2) / (nu + gamma), with gamma the number of parameters
    that the record determines and the user's own spread counting as nu parameters. Parameters that are right sharpen
    each other; parameters that are wrong free each other.

    Args:
        x: (p,), distances from the prescribed values, in the user's standard deviations.
        variance: (p,), posterior variances, in their squares.
        spread: Under which both were found.
    """
    determined = float((1.0 - variance / spread**2).clip(min=0.0).sum())
    return float(np.sqrt((PRIOR_PARAMETERS + float(x @ x)) / (PRIOR_PARAMETERS + determined)))
