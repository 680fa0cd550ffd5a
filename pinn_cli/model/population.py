"""Similar structures in one hierarchical model: theta_i ~ N(mu, diag(tau^2)), of each a Gaussian by its own record.

Of a record only what it says about the parameters is needed, precision and precision times mean: the Schur complement
that is left when its motion is integrated out. mu and theta are integrated out in closed form, tau_j on a grid, the
other spreads at their medians. Gelman (2006), Prior distributions for variance parameters in hierarchical models.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from pinn_cli.model.knowledge import ParameterKnowledge
from pinn_cli.system.priors import HALF_WIDTH_90

# With fewer the spread may be anything.
FEWEST = 3
# Chance that any structure of a population without an outlier is one.
RARE_OUTLIER = 0.01
# Spreads that are tried: first all that can be, then those about the probable ones. Rounds over the parameters.
SPREADS_TRIED, SPREADS_REFINED, POPULATION_ROUNDS = 120, 60, 4
# The least one, of the smallest standard deviation, which no record tells from none; the largest, of what is believed.
LEAST_TRIED, LARGEST_TRIED = 0.03, 30.0
# Probability that may lie beyond the finer grid. It begins so many times lower: without an outlier the spread is less.
OUTSIDE_GRID, WITHOUT_OUTLIER = 1e-3, 5.0
# Halvings to a quantile, from a range of so many standard deviations.
QUANTILE_HALVINGS, QUANTILE_REACH = 50, 8.0


class Information(NamedTuple):
    """What n records say by themselves, likelihoods exp(-theta' H theta / 2 + h' theta).

    Attributes:
        precision: (n, p, p), H.
        shift: (n, p), h.
    """

    precision: np.ndarray
    shift: np.ndarray

    def loosened(self, std: np.ndarray) -> Information:
        """The same about the mean of a distribution with these standard deviations (p,) that theta was drawn from."""
        inner = np.linalg.inv(np.eye(len(std)) + std[:, None] * self.precision * std)
        across = self.precision * std @ inner * std
        return Information(self.precision - across @ self.precision, self.shift - _times(across, self.shift))


def _times(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    out: np.ndarray = (matrices @ vectors[..., None])[..., 0]
    return out


@dataclass(frozen=True, eq=False)
class Units:
    """Where p parameters are counted from, and in what: what runs believe of a structure before its record.

    Attributes:
        center: (p,), of an unknown one, of which nothing is believed, where most runs found it.
        width: (p,), standard deviation.
    """

    center: np.ndarray
    width: np.ndarray

    @classmethod
    def of(cls, known: Sequence[ParameterKnowledge]) -> Units:
        """Of runs that have these parameters."""
        width = [np.where(each.sharing, each.spread, 1.0) * each.first_std for each in known]
        return cls(np.median([_prior_mean(each) for each in known], axis=0), np.max(width, axis=0))

    def information(self, known: ParameterKnowledge) -> Information:
        """Of one run: its posterior without the prior of what was believed, and with what its misfit may hide.

        A run's posterior is Gaussian in the parameters themselves, not in their logarithms: forces are linear in them,
        and bounds cut it off afterwards. The prior of an unknown one, ten of its values wide, is left where it is.
        """
        precision = np.linalg.inv(known.covariance / np.outer(self.width, self.width))
        prior = np.where(known.sharing, (self.width / (known.first_std * known.spread)) ** 2, 0.0)
        values, vectors = np.linalg.eigh(precision - np.diag(prior))
        told = vectors[:, values > 0.0]  # what rounding has made negative says nothing
        mean, believed = ((at - self.center) / self.width for at in (known.mean, _prior_mean(known)))
        shift = told @ (told.T @ (precision @ mean - prior * believed))
        says = Information(((told * values[values > 0.0]) @ told.T)[None], shift[None])
        return says.loosened(known.hidden / self.width)


def _prior_mean(known: ParameterKnowledge) -> np.ndarray:
    return known.mean if known.prescribed is None else np.where(known.sharing, known.prescribed, known.mean)


class Quantities(NamedTuple):
    """Medians of n structures, or of one more, with central 90 % intervals, in the parameters' units.

    Attributes:
        estimate: (n, p) or (p,).
        std: Likewise, standard deviations.
        lower: Likewise, ends of the intervals.
        upper: Likewise.
    """

    estimate: np.ndarray
    std: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


class Population:
    """n structures with p parameters, each of which tells the others what is usual.

    Args:
        known: Of each, as its run left it.
        lower: (p,), least values of the parameters; -inf without one.

    Attributes:
        alone, alone_std: (n, p), as the run of each has it.
        structures: With the records of all others; of one with an outlier as its run has it.
        off: (n, p), standard deviations from what the others let expect.
        outlier: (n, p), where that is rare. Such a structure is none of the population and tells nothing of the others.
        mean: mu.
        another: A structure that has not been measured.
        spread: tau; its interval is the shortest one, and begins at zero where the structures may be equal.
    """

    def __init__(self, known: Sequence[ParameterKnowledge], lower: np.ndarray) -> None:
        self._units = Units.of(known)
        parts = [self._units.information(each) for each in known]
        self._alone = Information(*(np.concatenate(part) for part in zip(*parts, strict=True)))
        self._lower = (lower - self._units.center) / self._units.width
        within = [each.within(lower) for each in known]
        self.alone = np.array([mean for mean, _ in within])
        self.alone_std = np.array([np.sqrt(np.diag(covariance)) for _, covariance in within])
        aside = np.zeros(len(known), bool)
        while True:
            structures, self.off = self._fit(aside)
            self.outlier = np.abs(self.off) > -ndtri(RARE_OUTLIER / 2.0 / self.off.size)
            found = aside | self.outlier.any(axis=1)
            if (found == aside).all() or (~found).sum() < FEWEST:
                break
            aside = found
        reach = HALF_WIDTH_90 * self.alone_std
        alone = (self.alone, self.alone_std, np.maximum(self.alone - reach, lower), self.alone + reach)
        as_told = zip(alone, structures, strict=True)
        self.structures = Quantities(*(np.where(aside[:, None], own, of_all) for own, of_all in as_told))

    def _fit(self, aside: np.ndarray) -> tuple[Quantities, np.ndarray]:
        """Mean and spread by all but those set aside (n,); returned are all structures, and how far off they are."""
        count = self.alone.shape[1]
        self._says = Information(*(np.where(aside.reshape(-1, *[1] * (x.ndim - 1)), 0.0, x) for x in self._alone))
        spread = np.ones(count)  # nothing is known of the others at first
        for _ in range(POPULATION_ROUNDS):
            for j in range(count):
                spread[j] = self._spread(j, spread).quantile(0.5)
        by_parameter = [self._of_parameter(j, self._spread(j, spread)) for j in range(count)]
        structures, mean, another, tau, off = (np.stack(part, axis=-1) for part in zip(*by_parameter, strict=True))
        self.mean, self.another = self._in_units(mean), self._in_units(another)
        self.spread = Quantities(*(self._units.width * tau))
        return self._in_units(structures), off

    def _in_units(self, values: np.ndarray) -> Quantities:
        center, width = self._units.center, self._units.width
        return Quantities(center + width * values[0], width * values[1], *(center + width * values[2:]))

    def _spread(self, j: int, spread: np.ndarray) -> Spread:
        """What all say of one parameter's spread, those of the others (p,) being as they are."""
        base = self._says.loosened(np.where(np.arange(len(spread)) == j, 0.0, spread))
        smallest = max(self._says.precision[:, j, j].max(), 1.0) ** -0.5
        coarse = Spread(j, base, np.geomspace(LEAST_TRIED * smallest, LARGEST_TRIED, SPREADS_TRIED))
        first, last = coarse.quantile(OUTSIDE_GRID), coarse.quantile(1.0 - OUTSIDE_GRID)
        return Spread(j, base, np.geomspace(max(first / WITHOUT_OUTLIER, coarse.tau[0]), last, SPREADS_REFINED))

    def _of_parameter(self, j: int, spread: Spread) -> tuple[np.ndarray, ...]:
        """Rows of `Quantities` of the structures (4, n), of mu, of another one, of the spread (4,); and off (n,)."""
        mass, least = spread.mass[:, None], self._lower[j]
        structures = mixture(mass, *spread.structures(), least)
        mean = spread.mean[:, None, j]
        std = np.sqrt(spread.covariance[:, None, j, j])
        of_mean = mixture(mass, mean, std, least)
        another = mixture(mass, mean, np.hypot(std, spread.tau[:, None]), least)
        # Of a record that says nothing, what is believed.
        covariance = np.linalg.inv(self._alone.precision + np.eye(len(self._lower)))
        found, variance = _times(covariance, self._alone.shift)[:, j], covariance[:, j, j]
        away = spread.without_each(found, variance)
        return structures, of_mean[:, 0], another[:, 0], spread.shortest(), away


class Spread:
    """The posterior of one parameter's spread on a grid, and what follows of the rest under each of its values.

    Its prior is half of a Cauchy distribution as wide as what is believed of one structure.

    Args:
        j: Which parameter.
        base: What n records say of mu where this parameter has no spread.
        tau: (G,), ascending.

    Attributes:
        mass: (G,), probabilities.
        mean: (G, p), of mu.
        covariance: (G, p, p), of mu.
    """

    def __init__(self, j: int, base: Information, tau: np.ndarray) -> None:
        self._j, self.tau, self._column, self._own = j, tau, base.precision[:, :, j], base.shift[:, j]
        # By the matrix inversion lemma: what one more variance takes away.
        square = tau[:, None] ** 2
        self._left = 1.0 / (1.0 + square * self._column[:, j])
        self._taken = square * self._left
        self._log = 0.5 * (np.log(self._left) + self._taken * self._own**2)
        self._precision = np.eye(base.shift.shape[1]) + base.precision.sum(0) - self._products(self._taken)
        self._shift = base.shift.sum(0) - (self._taken * self._own) @ self._column
        self._base = base
        self._edges = np.concatenate(([0.0], 0.5 * (tau[1:] + tau[:-1]), tau[-1:]))
        self.mean, self.covariance, self.mass = self._posterior(self._precision, self._shift, self._log.sum(1))

    def _products(self, weights: np.ndarray) -> np.ndarray:
        """(G, p, p), the sum of the structures' columns times themselves under weights (G, n)."""
        out: np.ndarray = np.einsum("gi,ia,ib->gab", weights, self._column, self._column, optimize=True)
        return out

    def _posterior(self, precision: np.ndarray, shift: np.ndarray, log: np.ndarray) -> tuple[np.ndarray, ...]:
        """Mean and covariance of mu, and the mass of every spread, along the first axis."""
        covariance = np.linalg.inv(precision)
        mean = _times(covariance, shift)
        log = log + 0.5 * ((shift * mean).sum(-1) - np.linalg.slogdet(precision)[1])
        weight = np.diff(self._edges) / (1.0 + self.tau**2)
        mass = np.exp(log - log.max(0)) * weight.reshape(-1, *[1] * (log.ndim - 1))
        return mean, covariance, mass / mass.sum(0)

    def quantile(self, probability: float | np.ndarray) -> np.ndarray:
        """Spreads below which it lies with these probabilities."""
        reached = np.concatenate(([0.0], np.cumsum(self.mass)))
        return np.asarray(np.interp(probability, reached, self._edges))

    def shortest(self) -> np.ndarray:
        """(4,): median, standard deviation, and the shortest interval of 90 %."""
        below = np.linspace(0.0, 0.1, 101)
        lower, upper = self.quantile(below), self.quantile(below + 0.9)
        best, mean = int(np.argmin(upper - lower)), self.mass @ self.tau
        std = np.sqrt(self.mass @ (self.tau - mean) ** 2)
        return np.array([self.quantile(0.5), std, lower[best], upper[best]])

    def structures(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation (G, n) of the parameter of every structure."""
        mean = self.mean[:, None, self._j] + self._taken * (self._own - self.mean @ self._column.T)
        by_mean = -self._taken[:, :, None] * self._column
        by_mean[:, :, self._j] += 1.0
        return mean, np.sqrt(
            self._taken + np.einsum("gia,gab,gib->gi", by_mean, self.covariance, by_mean, optimize=True)
        )

    def without_each(self, found: np.ndarray, variance: np.ndarray) -> np.ndarray:
        """(n,), how far a value found by itself (n,) is from what the other structures let expect, in standard ones."""
        taken = self._taken[:, :, None, None] * self._column[:, :, None] * self._column[:, None, :]
        precision = self._precision[:, None] - self._base.precision + taken
        shift = self._shift[:, None] - self._base.shift + (self._taken * self._own)[:, :, None] * self._column
        log = self._log.sum(1, keepdims=True) - self._log
        mean, covariance, mass = self._posterior(precision, shift, log)
        std = np.sqrt(variance + self.tau[:, None] ** 2 + covariance[:, :, self._j, self._j])
        away = (found - mean[:, :, self._j]) / std
        below, above = ((mass * ndtr(sign * away)).sum(0) for sign in (1.0, -1.0))
        smaller = np.maximum(np.minimum(below, above), np.finfo(float).tiny)
        out: np.ndarray = np.where(below > above, -1.0, 1.0) * ndtri(smaller)
        return out


def mixture(mass: np.ndarray, mean: np.ndarray, std: np.ndarray, least: float) -> np.ndarray:
    """(4, n): median, standard deviation, quantiles at 5 and 95 % of mixtures of G Gaussians above a least value.

    Of each the mass is (G, 1) or (G, n), mean and standard deviation (G, n); the least value is -inf without one.
    """
    center = (mass * mean).sum(0)
    deviation = np.sqrt((mass * (std**2 + (mean - center) ** 2)).sum(0))

    def below(value: np.ndarray) -> np.ndarray:
        out: np.ndarray = (mass * ndtr((value - mean) / std)).sum(0)
        return out

    cut = below(np.full(center.shape, least))
    probability = cut + np.array([[0.5], [0.05], [0.95]]) * (1.0 - cut)
    quantiles = []
    for wanted in probability:
        low, high = (mean - QUANTILE_REACH * std).min(0), (mean + QUANTILE_REACH * std).max(0)
        for _ in range(QUANTILE_HALVINGS):
            middle = 0.5 * (low + high)
            is_above = below(middle) > wanted
            low, high = np.where(is_above, low, middle), np.where(is_above, middle, high)
        quantiles.append(np.maximum(0.5 * (low + high), least))
    return np.stack((quantiles[0], deviation, *quantiles[1:]))
