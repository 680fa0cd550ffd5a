"""What a record leaves known: of the parameters, of the motion at its end, and of the noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np


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
        first_std: (p,), what the prior before the first of these records allowed.
    """

    mean: np.ndarray
    covariance: np.ndarray
    told: np.ndarray
    weight: np.ndarray
    first_std: np.ndarray

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

    def of(self, chosen: np.ndarray) -> ParameterKnowledge:
        """Of some parameters, the others integrated out."""
        each = (self.mean, self.told, self.weight, self.first_std)
        mean, told, weight, first = (values[chosen] for values in each)
        return ParameterKnowledge(mean, self.covariance[np.ix_(chosen, chosen)], told, weight, first)


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
class HandOver:
    """What is known where a later record goes on, from the samples up to there.

    Attributes:
        known: Of the parameters.
        end: The state there.
    """

    known: ParameterKnowledge
    end: EndState


@dataclass(frozen=True, eq=False)
class Levels:
    """Noise that was found.

    Attributes:
        sensors: Quantity to the standard deviation of its sensors (ndof,), NaN where there is none; ``force`` too.
        discrepancy: Standard deviation per sample of the force that the model leaves out, N; NaN where none was found.
        step: Between the samples, s: a discrepancy has the same power at any rate.
        force: That acted, N, root mean square.
        features: Of the network, per second and function; NaN of a network without any.
    """

    sensors: Mapping[str, np.ndarray]
    discrepancy: float
    step: float
    force: float
    features: float
