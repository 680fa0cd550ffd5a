"""A law that nobody knows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from scipy.linalg import null_space, svd

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import entries, is_finite_number, whole_number
from pinn_cli.system.array_namespace import Array
from pinn_cli.system.connection.nonlinearity import Nonlinearity

FEWEST_TERMS, MOST_TERMS = 2, 30
# Of what there is a curve over: the letter of its terms, and the unit.
LETTERS = {"elongation": "g", "speed": "h"}
SPAN_UNITS = {"elongation": "m", "speed": "m/s"}
# At which functions are compared with one another, over a span that goes from -1 to 1.
OVER_SPAN = np.linspace(-1.0, 1.0, 4001)
# Distance from rest over the span from which on knots that nobody chose are the further apart the further out they are:
# dry friction turns over in a hundredth of the speeds that occur, and far from rest a curve is smooth.
NEAR_REST = {"elongation": 1.0, "speed": 0.005}
# Standard deviation between two knots of a curve whose second derivative is white noise, as where it has corners, and
# that is known at both, with its slope, over the distance squared times the second derivative as far as the knots
# follow it: its variance is d^3 / 420 of the noise's, that of what they follow 1 / d.
BETWEEN_KNOTS = 420.0**-0.5
# Knots are moved where the most of it falls below this part, and come no nearer to each other than this over half the
# span, which are a few of the places above: between them functions could not be told apart.
WORTH_MOVING, NEAREST = 0.7, 0.002


class Spline(Nonlinearity):
    """A force that nobody has a law for, r_n = g(e) + h(de): what is neither there at rest, nor a spring or a damper.

    Each curve is a cubic spline, g = g_1 phi_1(e) + g_2 phi_2(e) + ..., in N. Each function is rougher than the one
    before. It is zero at rest, has no part in k e, and over the span a root mean square of one; there it ends above
    zero, and beyond it becomes a straight line. A term may be the smaller the rougher its function is, which is the
    prior of a smoothing spline of third derivatives (Wahba, Spline Models for Observational Data, 1990, chapter 1) in
    the functions of Demmler and Reinsch: beyond what occurs a curve goes on to bend as it does. Knots that nobody chose
    are the nearer to each other the nearer to rest they are, over speed two hundred times; an estimator then sets them
    where the curve that it finds bends.

    Args:
        elongation: Over which g is a curve, m: up to a number either way, or from one to another; None: there is no g.
        speed: Of the elongation, over which h is a curve, m/s, likewise.
        terms: Of each curve; None: 30 of all.
        knots: Of each curve, as many as terms, from one end of its span to the other: ``elongation``, m, and ``speed``,
            m/s. They are where an estimator begins, and may move them. None: nobody has chosen any.

    Raises:
        InputError: Neither span is given, or one does not go from below zero to above it; ``terms`` is no number from 2
            to 30; ``knots`` are no such numbers.
    """

    name = "spline"

    def __init__(
        self,
        elongation: float | Sequence[float] | None = None,
        speed: float | Sequence[float] | None = None,
        terms: int | None = None,
        knots: Mapping[str, Sequence[float]] | None = None,
    ) -> None:
        self.elongation, self.speed, self.knots = elongation, speed, knots
        given = {"elongation": elongation, "speed": speed}
        self.spans: Mapping[str, tuple[float, float]] = {k: _span(k, x) for k, x in given.items() if x is not None}
        if terms is None:
            chosen = [len(entries(x)) for x in knots.values()] if isinstance(knots, Mapping) else []
            terms = max(FEWEST_TERMS, *chosen) if chosen else MOST_TERMS // max(1, len(self.spans))
        self.terms = whole_number("system.nonlinearity.terms", terms, least=FEWEST_TERMS, most=MOST_TERMS)
        self._curves = {
            LETTERS[k]: _Curve(LETTERS[k], span, NEAR_REST[k], _knots(k, span, self.terms, NEAR_REST[k], knots))
            for k, span in self.spans.items()
        }
        if not self._curves:
            allowed, hint = "given in m, or speed in m/s", "the force is a curve up to there: the largest that occurs"
            raise InputError("system.nonlinearity.elongation", None, allowed, hint)
        self.curves = tuple(curve.kinds for curve in self._curves.values())
        self.parameters = tuple(kind for kinds in self.curves for kind in kinds)
        self.titles: Mapping[str, str] = {kind: f"Term {kind[2:]} of the curve" for kind in self.parameters}
        self.units: Mapping[str, str] = dict.fromkeys(self.parameters, "N")

    def force(self, e: Array, de: Array, parameters: Mapping[str, Array]) -> Array:
        """See :meth:`Nonlinearity.force`."""
        total = 0.0 * e
        for letter, curve in self._curves.items():
            total = total + curve.force(e if letter == "g" else de, parameters)
        return total

    def unresolved(self, e: Array, de: Array, parameters: Mapping[str, Array]) -> Array:
        """See :meth:`Nonlinearity.unresolved`."""
        square = 0.0 * e
        for letter, curve in self._curves.items():
            square = square + curve.unresolved(e if letter == "g" else de, parameters) ** 2
        root: Array = square**0.5
        return root

    def bending_at(self, parameters: Mapping[str, np.ndarray]) -> Spline:
        """See :meth:`Nonlinearity.bending_at`: with other knots."""
        curves = {k: self._curves[LETTERS[k]] for k in self.spans}
        knots = {k: curve.bending_at(parameters) for k, curve in curves.items()}
        if all(knots[k] is curve.inner for k, curve in curves.items()):
            return self
        given = {k: curve.given(knots[k]) for k, curve in curves.items()}
        return Spline(self.elongation, self.speed, self.terms, given)

    def terms_of(self, other: Nonlinearity, parameters: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
        """See :meth:`Nonlinearity.terms_of`: of the curves that come nearest over the span."""
        assert isinstance(other, Spline)
        pairs = ((curve, other._curves[letter]) for letter, curve in self._curves.items())
        return {kind: x for curve, theirs in pairs for kind, x in curve.terms_of(theirs, parameters).items()}

    def starts(self, stiffness: float, elongation: float) -> Mapping[str, tuple[float, ...]]:
        """See :meth:`Nonlinearity.starts`: no curve; what counts is the spring's force, and rough terms are smaller."""
        force = stiffness * elongation
        pairs = [pair for curve in self._curves.values() for pair in zip(curve.kinds, curve.smaller, strict=True)]
        return {kind: (0.0, force, force * smaller) for kind, smaller in pairs}

    def stiffness_at_rest(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray | float:
        """See :meth:`Nonlinearity.stiffness_at_rest`."""
        return self._curves["g"].slope_at_rest(parameters) if "g" in self._curves else 0.0

    def damping_at_rest(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray | float:
        """See :meth:`Nonlinearity.damping_at_rest`."""
        return self._curves["h"].slope_at_rest(parameters) if "h" in self._curves else 0.0


class _Curve:
    """Over one of the two, within a span.

    Args:
        letter: Of its terms.
        span: From where to where.
        near: See :data:`NEAR_REST`.
        knots: (terms,), from one end to the other of a span that goes from -1 to 1.

    Attributes:
        kinds: Of the terms.
        inner: The knots.
        smaller: (terms,), how large each may be over the third, and at most as large as that.
    """

    def __init__(self, letter: str, span: tuple[float, float], near: float, knots: np.ndarray) -> None:
        # Of so many functions of the knots, two and two more fall to what is asked of them.
        self.kinds = tuple(f"{letter}_{i}" for i in range(1, len(knots) + 1))
        low, high = span
        self._middle, self._half, self.inner = (low + high) / 2.0, (high - low) / 2.0, knots
        self._rest, self._near = -self._middle / self._half, near
        # A curve is straight from a knot beyond the span on, within which it ends in any bend.
        knots = self._knots = np.r_[2.0 * knots[0] - knots[1], knots, 2.0 * knots[-1] - knots[-2]]
        rest = np.array([self._rest])
        raw, at_rest = self._powers(OVER_SPAN), self._powers(rest)
        beyond = np.pad([knots**0, knots], ((0, 0), (2, 0)))
        free = null_space(np.stack((*beyond, at_rest[0], (OVER_SPAN - rest) @ raw / len(OVER_SPAN))))
        # Orthonormal over the span. Knots that are near to each other leave no digits to products of these.
        _, size, turned = svd(raw @ free / len(OVER_SPAN) ** 0.5, full_matrices=False)
        free = free @ (turned.T / size)
        # Counted over the distance of knots there: what is between near ones is as rough as between far ones.
        within = (OVER_SPAN[1:] + OVER_SPAN[:-1]) / 2.0
        bends = np.pad(6.0 * (within[:, None] > knots), ((0, 0), (2, 0))) @ free
        _, sizes, turned = svd(_distance(knots, within)[:, None] ** 2.5 * bends, full_matrices=False)
        free = free @ turned[::-1].T
        # What each function is made of (terms, 2 + knots): one, x, and the knots' cubes.
        self._made_of = (free * np.sign(raw[-1] @ free)).T
        # The first is a parabola, which costs nothing, and over speed the second, a step at rest, next to nothing.
        third = sizes[-3:][0]
        self.smaller = third / np.maximum(sizes[::-1], third)
        self._slopes = self._made_of @ np.r_[0.0, 1.0, 3.0 * np.maximum(rest - knots, 0.0) ** 2] / self._half

    def force(self, at: Array, parameters: Mapping[str, Array]) -> Array:
        """At elongations, or at speeds (..., C), N."""
        x, weights = self._of(at, parameters)
        cubes = _beyond(x, _like(self._knots, at)) ** 3
        curve: Array = weights[..., 0] + weights[..., 1] * x + (weights[..., 2:] * cubes).sum(-1)
        return curve

    def unresolved(self, at: Array, parameters: Mapping[str, Array]) -> Array:
        """See :data:`BETWEEN_KNOTS`: (..., C), N."""
        x, weights = self._of(at, parameters)
        bend = 6.0 * (weights[..., 2:] * _beyond(x, _like(self._knots, at))).sum(-1)
        apart = _like(_distance(self._knots, np.asarray(x)) ** 2, at)
        between: Array = BETWEEN_KNOTS * apart * abs(bend)
        return between

    def bending_at(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray:
        """Better knots, half of them where nobody would move them, half where the curve bends; else :attr:`inner`.

        What lies between knots is as large everywhere where they are as dense as the root of the bend (de Boor, A
        Practical Guide to Splines, 1978, chapter 12); as dense as the bend itself they come together faster about a
        corner. Of both, those that leave the less. Of several connections that is the mean.
        """
        bend = abs(_beyond(OVER_SPAN, self._knots) @ (self._terms(parameters) @ self._made_of)[:, 2:].T).mean(-1)
        if not bend.any():
            return self.inner
        even = 1.0 / np.hypot(OVER_SPAN - self._rest, self._near)
        moved = [self._as_dense_as(even / even.sum() + x / x.sum()) for x in (np.sqrt(bend), bend)]
        now, *then = (np.max(_distance(knots, OVER_SPAN) ** 2 * bend) for knots in (self.inner, *moved))
        return moved[int(np.argmin(then))] if min(then) < WORTH_MOVING * now else self.inner

    def _as_dense_as(self, shares: np.ndarray) -> np.ndarray:
        """(terms,), of shares over the span, but nowhere denser than :data:`NEAREST`."""
        density = shares / np.trapezoid(shares, OVER_SPAN)
        passed = np.cumsum(np.minimum(density, 1.0 / (NEAREST * len(self.inner))))
        return np.interp(np.linspace(passed[0], passed[-1], len(self.inner)), passed, OVER_SPAN)

    def given(self, knots: np.ndarray) -> list[float]:
        """(terms,), m or m/s, of knots over a span that goes from -1 to 1."""
        given: list[float] = (self._middle + self._half * knots).tolist()
        return given

    def terms_of(self, other: _Curve, parameters: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """See :meth:`Spline.terms_of`."""
        mine, theirs = (curve._powers(OVER_SPAN) @ curve._made_of.T for curve in (self, other))
        terms = np.linalg.lstsq(mine, theirs @ other._terms(parameters).T, rcond=None)[0]
        return dict(zip(self.kinds, terms, strict=True))

    def _terms(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray:
        """(C, terms)."""
        return np.stack([np.atleast_1d(parameters[kind]) for kind in self.kinds], -1)

    def _powers(self, x: np.ndarray) -> np.ndarray:
        """(places, 2 + knots), what each function is made of, at places over a span that goes from -1 to 1."""
        return np.concatenate([np.stack((x**0, x), -1), _beyond(x, self._knots) ** 3], -1)

    def _of(self, at: Array, parameters: Mapping[str, Array]) -> tuple[Array, Array]:
        """Where that is in the span (..., C), and what the curve is made of, (C, 2 + knots)."""
        x, terms = (at - self._middle) / self._half, [parameters[kind] for kind in self.kinds]
        if isinstance(at, np.ndarray):  # a simulation asks at every step, and np.stack looks at each of them
            return x, np.moveaxis(np.array(terms), 0, -1) @ self._made_of
        return x, torch.stack(terms, -1) @ _like(self._made_of, at)

    def slope_at_rest(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray:
        """(C,), N/m or N s/m."""
        slope: np.ndarray = np.stack([parameters[kind] for kind in self.kinds], -1) @ self._slopes
        return slope


def _span(name: str, given: Any) -> tuple[float, float]:
    ends = [-given, given] if is_finite_number(given) else entries(given)
    if len(ends) != 2 or not all(map(is_finite_number, ends)) or not ends[0] < 0.0 < ends[1]:
        allowed = f"a number > 0, or two, the first below zero and the second above, in {SPAN_UNITS[name]}"
        raise InputError(f"system.nonlinearity.{name}", given, allowed)
    return float(ends[0]), float(ends[1])


def _knots(
    name: str, span: tuple[float, float], terms: int, near: float, given: Mapping[str, Sequence[float]] | None
) -> np.ndarray:
    """(terms,), over a span that goes from -1 to 1: those given, or see :data:`NEAR_REST`."""
    middle, half = (span[0] + span[1]) / 2.0, (span[1] - span[0]) / 2.0
    if given is None:
        rest = -middle / half
        first, last = np.arcsinh((np.array([-1.0, 1.0]) - rest) / near).tolist()
        return rest + near * np.sinh(np.linspace(first, last, terms))
    knots = entries(given.get(name)) if isinstance(given, Mapping) else []
    is_whole = len(knots) == terms and all(map(is_finite_number, knots))
    if not is_whole or not np.all(np.diff(knots) > 0.0) or not np.allclose([knots[0], knots[-1]], span):
        allowed = f"{terms} rising numbers in {SPAN_UNITS[name]}, from one end of the span to the other"
        raise InputError(f"system.nonlinearity.knots.{name}", given, allowed)
    return (np.array(knots, dtype=float) - middle) / half


def _distance(knots: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Of the knots about places."""
    between = (knots[1:] + knots[:-1]) / 2.0
    distance: np.ndarray = np.exp(np.interp(x, between, np.log(np.diff(knots))))
    return distance


def _beyond(x: Array, knots: Array) -> Array:
    """(..., knots), how far x is beyond each knot, and 0 before it."""
    beyond = x[..., None] - knots
    return (beyond + abs(beyond)) / 2.0


def _like(values: np.ndarray, x: Array) -> Any:
    """An array where x is one, a tensor where x is."""
    return values if isinstance(x, np.ndarray) else torch.as_tensor(values, dtype=x.dtype, device=x.device)
