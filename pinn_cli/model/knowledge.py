"""What a record leaves known of a structure: parameters, the motion at its end, the noise, and the force left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import lsq_linear

from pinn_cli.model.truncated_gaussian import TruncatedGaussian

if TYPE_CHECKING:
    from pinn_cli.system.parameters import Parameter
    from pinn_cli.system.structure import Structure

# Numbers of a misfit's history that are kept, 4 MB: of a longer record the last part stands for all of it.
MOST_KEPT = 2**20


@dataclass(frozen=True, eq=False)
class ParameterKnowledge:
    """A Gaussian of p parameters, in their units: the posterior of a record without what bounds cut off.

    What the model leaves out hides a part of each parameter that no record's length averages out; it stands beside the
    covariance, so that a later record adds to the knowledge as if both had been solved together.

    Attributes:
        mean: (p,).
        covariance: (p, p), of what noise leaves open.
        told: (p,), per unit: sum over the records of the values that tell times the force of one unit over the misfit.
        weight: (p,), per square unit: the same with the square of that ratio.
        first_std: (p,), what the prior before the first of these records allowed; of prescribed parameters their common
            spread was counted in it.
        prescribed: (p,), the mean of that prior of every parameter that shares the common spread, NaN of all others;
            None: none does.
        spread: That was found, in ``first_std``.
    """

    mean: np.ndarray
    covariance: np.ndarray
    told: np.ndarray
    weight: np.ndarray
    first_std: np.ndarray
    prescribed: np.ndarray | None = None
    spread: float = 1.0

    @property
    def std(self) -> np.ndarray:
        """(p,), standard deviations that noise leaves open."""
        out: np.ndarray = np.sqrt(np.diag(self.covariance))
        return out

    @property
    def correlation(self) -> np.ndarray:
        """(p, p)."""
        out: np.ndarray = self.covariance / np.outer(self.std, self.std)
        return out

    @cached_property
    def precision(self) -> np.ndarray:
        """(p, p), the inverse of the correlation."""
        root = np.linalg.inv(np.linalg.cholesky(self.correlation))
        return root.T @ root

    @property
    def sharing(self) -> np.ndarray:
        """(p,) bool: the parameters that share the common spread."""
        return np.zeros(len(self.mean), bool) if self.prescribed is None else np.isfinite(self.prescribed)

    def with_spread(self, spread: float) -> ParameterKnowledge:
        """The same under another common spread: what the records say stays, and the first prior is another one."""
        sharing = self.sharing
        if not sharing.any() or spread == self.spread:
            return self
        assert self.prescribed is not None
        unit = np.where(sharing, self.first_std, self.std)
        pull = np.where(sharing, np.nan_to_num(self.prescribed) - self.mean, 0.0) / unit
        precision = np.linalg.inv(self.covariance / np.outer(unit, unit))
        values, vectors = np.linalg.eigh(precision - np.diag(sharing / self.spread**2))
        records = (vectors * values.clip(min=0.0)) @ vectors.T  # what rounding has made negative says nothing
        covariance = np.linalg.inv(records + np.diag(sharing / spread**2))
        moved = covariance @ (pull * (spread**-2 - self.spread**-2))
        return replace(self, mean=self.mean + unit * moved, covariance=covariance * np.outer(unit, unit), spread=spread)

    @property
    def hidden(self) -> np.ndarray:
        """(p,), standard deviation of what the misfit may hide of each parameter, within what its prior allowed."""
        free = np.divide(self.told, self.weight, out=np.zeros(len(self.told)), where=self.weight > 0)
        out: np.ndarray = free / np.hypot(1.0, free / self.first_std)
        return out

    @property
    def whole(self) -> np.ndarray:
        """(p, p), covariance with what the misfit may hide."""
        return self.covariance + np.diag(self.hidden**2)

    def within(self, lower: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean (p,) and covariance (p, p), with what the misfit may hide, of what lies above least values (p,)."""
        posterior, hidden = TruncatedGaussian(self.mean, self.covariance, lower), self.hidden
        alone = posterior.marginals((0.05, 0.95), hidden)
        together = posterior.covariance + np.diag(hidden**2)
        unit = alone.std / np.sqrt(np.diag(together))
        return alone.mean, together * np.outer(unit, unit)

    def most_probable(self, lower: np.ndarray) -> np.ndarray:
        """(p,), the peak above least values (p,): those that a bound holds move the others along."""
        if not (self.mean < lower).any():
            return self.mean
        root = np.linalg.inv(np.linalg.cholesky(self.correlation))
        bounded = lsq_linear(root, root @ (self.mean / self.std), (lower / self.std, np.inf))
        out: np.ndarray = np.maximum(self.std * bounded.x, lower)
        return out

    def of(self, chosen: np.ndarray) -> ParameterKnowledge:
        """Of some parameters, the others integrated out."""
        vectors = (self.mean, self.told, self.weight, self.first_std)
        mean, told, weight, first = (values[chosen] for values in vectors)
        prescribed = None if self.prescribed is None else self.prescribed[chosen]
        covariance = self.covariance[np.ix_(chosen, chosen)]
        return ParameterKnowledge(mean, covariance, told, weight, first, prescribed, self.spread)

    def with_independent(self, mean: Sequence[float], std: Sequence[float]) -> ParameterKnowledge:
        """With parameters behind these that have nothing to do with them."""
        nothing = np.zeros(len(std))
        return ParameterKnowledge(
            np.append(self.mean, mean),
            block_diag(self.covariance, np.diag(np.square(std))),
            np.append(self.told, nothing),
            np.append(self.weight, nothing),
            np.append(self.first_std, std),
            None if self.prescribed is None else np.append(self.prescribed, np.full(len(std), np.nan)),
            self.spread,
        )


@dataclass(frozen=True, eq=False)
class EndState:
    """Displacement, velocity and hidden forces of the coordinates at a record's last sample.

    Attributes:
        time: Of that sample, s.
        mean: (2 n + h,).
        covariance: (2 n + h, 2 n + h).
        with_parameters: (2 n + h, p), covariance with the parameters.
    """

    time: float
    mean: np.ndarray
    covariance: np.ndarray
    with_parameters: np.ndarray


@dataclass(frozen=True, eq=False)
class DiscrepancyEvidence:
    """What the windows of a record say of its discrepancy, which each alone may leave open.

    Attributes:
        start: Discrepancy of the last one over the force that acts, per root of a second, with no band left out.
        common: Whether it is what all windows say, and not that one's own.
        places: (G,), decimal logarithms of discrepancies, ascending.
        log_evidence: (G,), of all windows under each, up to a constant.
    """

    start: float
    common: bool
    places: np.ndarray
    log_evidence: np.ndarray

    def at(self, places: np.ndarray) -> np.ndarray:
        """(H,) log evidence at other places (H,); beyond its own it stays what it is."""
        if len(self.places) == 0:
            return np.zeros(len(places))
        out: np.ndarray = np.interp(places, self.places, self.log_evidence)
        return out


@dataclass(frozen=True, eq=False)
class HandOver:
    """What is known where a later record goes on, from the samples up to there.

    Attributes:
        known: Of the parameters.
        end: The state there.
        discrepancy: What is known of it; None: nothing beside its size.
    """

    known: ParameterKnowledge
    end: EndState
    discrepancy: DiscrepancyEvidence | None = None


@dataclass(frozen=True, eq=False)
class Levels:
    """Noise that was found.

    Attributes:
        sensors: Quantity to the standard deviation of its sensors (ndof,), NaN where there is none; ``force`` too.
        discrepancy: Standard deviation per sample of the force that the model leaves out, N; NaN where none was found.
        step: Between the samples, s: a discrepancy has the same power at any rate.
        force: That acted, N, root mean square.
        features: Of the network, per second and function; NaN of a network without any.
        windows: What windows of one record say of the discrepancy together; None of any other record.
    """

    sensors: Mapping[str, np.ndarray]
    discrepancy: float
    step: float
    force: float
    features: float
    windows: DiscrepancyEvidence | None = None


@dataclass(frozen=True, eq=False)
class Misfit:
    """The force that a model leaves out: what the coordinates feel beside their laws and the measured inputs.

    A forgotten spring or a wrong mass leaves out a force that has most of its power at resonances and acts on several
    coordinates at once. A white force of its size moves the structure far less. So the force is kept as it was.

    Attributes:
        step: Between samples, s.
        history: (L, n), N, at even samples: its posterior mean, without the noise of the inputs' sensors.
        acting: N, root mean square of what the measured inputs put into the equations; 0 where nothing was measured.
        rest: N, standard deviation per sample of a white force on every coordinate: what the record leaves open.
        at_motion: Share, root mean square, of it at the frequencies at which the coordinates move: what may hide in the
            parameters; 1 where nobody asked.
    """

    step: float
    history: np.ndarray
    acting: float
    rest: float
    at_motion: float = 1.0

    @classmethod
    def of(cls, step: float, history: np.ndarray, acting: float, rest: float, at_motion: float = 1.0) -> Misfit:
        """Of a history (N, n), of which no more than can be kept is."""
        most = max(2, MOST_KEPT // max(history.shape[1], 1))
        return cls(step, history[-most:].astype(np.float32), acting, rest, at_motion)


@dataclass(frozen=True, eq=False)
class Model:
    """An identified structure: no truth is in it, only what was prescribed and what was found.

    Attributes:
        structure: With the estimates in place.
        parameters: Those that were uncertain, p of them; ``prescribed`` is their mean.
        known: Of them; its covariance is NaN where the training told no standard deviations.
        draws: (D, p), of a sampled posterior; None without one.
        misfit: The force that the model leaves out; None where the training does not say.
        levels: Noise that was found.
        end: Where the motion ended; None where nobody knows.
        verdict: On the run, and the first reason for it; "" without one.
        reason: Likewise.
        directory: Of the run.
    """

    structure: Structure
    parameters: tuple[Parameter, ...]
    known: ParameterKnowledge
    levels: Levels
    end: EndState | None
    verdict: str
    reason: str
    draws: np.ndarray | None = None
    directory: Path = Path()
    misfit: Misfit | None = None

    @property
    def lower(self) -> np.ndarray:
        """(p,), least values of the parameters; -inf without one."""
        return np.array([0.0 if p.positive else -np.inf for p in self.parameters])

    @property
    def used(self) -> tuple[np.ndarray, np.ndarray]:
        """What a record that adds nothing to it takes for known: the estimates of the run's table (p,), and covariance.

        They need not be the posterior's means: where a structure runs free, they are what makes it run.
        """
        estimates = [float(self.structure.parameters[p.kind][p.index]) for p in self.parameters]
        return np.array(estimates), self.known.within(self.lower)[1]
