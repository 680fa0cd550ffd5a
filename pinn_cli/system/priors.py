"""What is believed of a parameter before the record is seen: densities, their slopes and draws, in closed form."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
from scipy.special import gammaln, ndtri

# Half the width of the central 90 and 95 % intervals of a normal distribution, in standard deviations.
HALF_WIDTH_90, HALF_WIDTH_95 = float(ndtri(0.95)), float(ndtri(0.975))


class Prior(ABC):
    """A distribution of one parameter, in the parameter's unit.

    A new one is a dataclass here and a row of ``prior_settings.KINDS``. A field may also be an array: then the object
    is as many priors at once, and its methods take an array theta of as many parameters (:func:`stacked`).

    Attributes:
        name: What ``scheme.priors`` calls it.
        positive: Whether the parameter cannot be below zero; densities are then asked for theta > 0 only.
    """

    name: ClassVar[str]
    positive: ClassVar[bool]

    @abstractmethod
    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """Logarithm of the density at theta, normalised."""

    @abstractmethod
    def slope(self, theta: np.ndarray) -> np.ndarray:
        """Derivative of :meth:`log_density` by theta."""

    @abstractmethod
    def sample(self, generator: np.random.Generator, count: int) -> np.ndarray:
        """(count,) independent draws."""

    @property
    @abstractmethod
    def mean(self) -> float:
        """Expectation."""

    @property
    @abstractmethod
    def std(self) -> float:
        """Standard deviation."""


@dataclass(frozen=True)
class Gamma(Prior):
    """Density theta^(shape - 1) exp(-rate theta), the one of the paper's authors."""

    shape: float
    rate: float
    name = "gamma"
    positive = True

    @classmethod
    def of_moments(cls, mean: float, std: float) -> Gamma:
        """The one with this expectation and this standard deviation."""
        return cls((mean / std) ** 2, mean / std**2)

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """See :meth:`Prior.log_density`."""
        constant = self.shape * np.log(self.rate) - gammaln(self.shape)
        return (self.shape - 1) * np.log(theta) - self.rate * theta + constant

    def slope(self, theta: np.ndarray) -> np.ndarray:
        """See :meth:`Prior.slope`."""
        return (self.shape - 1) / theta - self.rate

    def sample(self, generator: np.random.Generator, count: int) -> np.ndarray:
        """See :meth:`Prior.sample`."""
        return generator.gamma(self.shape, 1 / self.rate, count)

    @property
    def mean(self) -> float:
        """See :attr:`Prior.mean`."""
        return self.shape / self.rate

    @property
    def std(self) -> float:
        """See :attr:`Prior.std`."""
        return math.sqrt(self.shape) / self.rate


@dataclass(frozen=True)
class HalfNormal(Prior):
    """Density exp(-theta^2 / (2 scale^2)): flat below its scale."""

    scale: float
    name = "half_normal"
    positive = True

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """See :meth:`Prior.log_density`."""
        return -0.5 * (theta / self.scale) ** 2 - np.log(self.scale) - 0.5 * math.log(math.pi / 2)

    def slope(self, theta: np.ndarray) -> np.ndarray:
        """See :meth:`Prior.slope`."""
        return -theta / np.square(self.scale)

    def sample(self, generator: np.random.Generator, count: int) -> np.ndarray:
        """See :meth:`Prior.sample`."""
        return self.scale * np.abs(generator.standard_normal(count))

    @property
    def mean(self) -> float:
        """See :attr:`Prior.mean`."""
        return self.scale * math.sqrt(2 / math.pi)

    @property
    def std(self) -> float:
        """See :attr:`Prior.std`."""
        return self.scale * math.sqrt(1 - 2 / math.pi)


@dataclass(frozen=True)
class LogNormal(Prior):
    """log theta is Gaussian: around log median, with standard deviation sigma."""

    median: float
    sigma: float
    name = "log_normal"
    positive = True

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """See :meth:`Prior.log_density`."""
        log_theta = np.log(theta)
        off = (log_theta - np.log(self.median)) / self.sigma
        return -0.5 * off**2 - log_theta - np.log(self.sigma) - 0.5 * math.log(2 * math.pi)

    def slope(self, theta: np.ndarray) -> np.ndarray:
        """See :meth:`Prior.slope`."""
        return -(1 + np.log(theta / self.median) / np.square(self.sigma)) / theta

    def sample(self, generator: np.random.Generator, count: int) -> np.ndarray:
        """See :meth:`Prior.sample`."""
        return self.median * np.exp(self.sigma * generator.standard_normal(count))

    @property
    def mean(self) -> float:
        """See :attr:`Prior.mean`."""
        return self.median * float(np.exp(self.sigma**2 / 2))

    @property
    def std(self) -> float:
        """See :attr:`Prior.std`."""
        return self.mean * float(np.sqrt(np.expm1(self.sigma**2)))


@dataclass(frozen=True)
class Normal(Prior):
    """The Gaussian; the only one of these that allows negative values."""

    location: float
    scale: float
    name = "normal"
    positive = False

    def log_density(self, theta: np.ndarray) -> np.ndarray:
        """See :meth:`Prior.log_density`."""
        return -0.5 * ((theta - self.location) / self.scale) ** 2 - np.log(self.scale) - 0.5 * math.log(2 * math.pi)

    def slope(self, theta: np.ndarray) -> np.ndarray:
        """See :meth:`Prior.slope`."""
        return (self.location - theta) / np.square(self.scale)

    def sample(self, generator: np.random.Generator, count: int) -> np.ndarray:
        """See :meth:`Prior.sample`."""
        return generator.normal(self.location, self.scale, count)

    @property
    def mean(self) -> float:
        """See :attr:`Prior.mean`."""
        return self.location

    @property
    def std(self) -> float:
        """See :attr:`Prior.std`."""
        return self.scale


def stacked(priors: Sequence[Prior]) -> list[tuple[np.ndarray, Prior]]:
    """Priors of one class as a single object with arrays for fields, each with the places (g,) of its members.

    A sampler asks for all densities a hundred thousand times: one call per class instead of one per parameter.
    """
    groups = []
    for kind in dict.fromkeys(type(prior) for prior in priors):
        places = [i for i, prior in enumerate(priors) if type(prior) is kind]
        arrays: dict[str, Any] = {
            field.name: np.array([getattr(priors[i], field.name) for i in places], dtype=float)
            for field in fields(kind)  # type: ignore[arg-type]
        }
        groups.append((np.array(places), kind(**arrays)))
    return groups
