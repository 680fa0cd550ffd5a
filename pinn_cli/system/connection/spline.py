"""A law that nobody knows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from scipy.linalg import eigh, null_space

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import entries, is_finite_number, whole_number
from pinn_cli.system.array_namespace import Array
from pinn_cli.system.connection.nonlinearity import Nonlinearity

MOST_TERMS = 30
# Of what there is a curve over: the letter of its terms, and the unit.
LETTERS = {"elongation": "g", "speed": "h"}
SPAN_UNITS = {"elongation": "m", "speed": "m/s"}
# At which functions are compared with one another, over a span that goes from -1 to 1.
OVER_SPAN = np.linspace(-1.0, 1.0, 2001)
# Distance from rest over the span from which on knots are the further apart the further from rest they are: dry
# friction turns over in a hundredth of the speeds that occur, and far from rest a curve is smooth.
NEAR_REST = {"elongation": 1.0, "speed": 0.01}
# Standard deviation between two knots of a curve whose second derivative is white noise (which the prior of a smoothing
# spline says) and which is known at both, with its slope, over the distance squared times the second derivative as
# far as the knots follow it: its variance is d^3 / 420 of the noise's, that of what they follow 1 / d.
BETWEEN_KNOTS = 420.0**-0.5


class Spline(Nonlinearity):
    """A force that nobody has a law for, r_n = g(e) + h(de): what is neither there at rest, nor a spring or a damper.

    Each curve is a natural cubic spline, g = g_1 phi_1(e) + g_2 phi_2(e) + ..., in N. Each function is rougher than the
    one before. It is zero at rest, has no part in k e, and over the span a root mean square of one; there it ends above
    zero, and beyond it becomes a straight line. A term may be the smaller the rougher its function is, which is the
    prior of a smoothing spline (Wahba, Spline Models for Observational Data, 1990, chapter 1) in the functions of
    Demmler and Reinsch. Knots are the nearer to each other the nearer to rest they are, over speed a hundred times.

    Args:
        elongation: Over which g is a curve, m: up to a number either way, or from one to another; None: there is no g.
        speed: Of the elongation, over which h is a curve, m/s, likewise.
        terms: Of each curve; None: 30 of all.

    Raises:
        InputError: Neither span is given, or one does not go from below zero to above it; ``terms`` is no number from 1
            to 30.
    """

    name = "spline"

    def __init__(
        self,
        elongation: float | Sequence[float] | None = None,
        speed: float | Sequence[float] | None = None,
        terms: int | None = None,
    ) -> None:
        given = {"elongation": elongation, "speed": speed}
        self.spans: Mapping[str, tuple[float, float]] = {k: _span(k, x) for k, x in given.items() if x is not None}
        terms = MOST_TERMS // max(1, len(self.spans)) if terms is None else terms
        self.terms = whole_number("system.nonlinearity.terms", terms, least=1, most=MOST_TERMS)
        self._curves = {
            LETTERS[k]: _Curve(LETTERS[k], span, self.terms, NEAR_REST[k]) for k, span in self.spans.items()
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
    """Over one of the two, within a span; see :data:`NEAR_REST`.

    Attributes:
        kinds: Of the terms.
        smaller: (terms,), how large each may be over the second, and at most as large as that.
    """

    def __init__(self, letter: str, span: tuple[float, float], terms: int, near: float) -> None:
        self.kinds = tuple(f"{letter}_{i}" for i in range(1, terms + 1))
        low, high = span
        self._middle, self._half = (low + high) / 2.0, (high - low) / 2.0
        # Of so many functions of the knots, two and two more fall to what is asked of them. The ends, where the curve
        # becomes straight, lie outside the span: within it most laws are not.
        end = 1.0 + 2.0 / (terms + 1)
        rest = np.array([-self._middle / self._half])
        # A bend counts over the distance of knots there: a step near rest is as rough as a wide one further out.
        first, last = np.arcsinh((np.array([-end, end]) - rest) / near).tolist()
        self._knots = rest + near * np.sinh(np.linspace(first, last, terms + 2))
        self._rest, self._near, self._apart = float(rest[0]), near, (last - first) / (terms + 1)
        distance = np.hypot(end * OVER_SPAN - rest, near)
        raw, at_rest = (
            np.concatenate([np.stack((x**0, x), -1), _beyond(x, self._knots) ** 3], -1) for x in (OVER_SPAN, rest)
        )
        bent = np.pad(6.0 * np.maximum(end * OVER_SPAN[:, None] - self._knots, 0.0), ((0, 0), (2, 0)))
        beyond = np.pad([self._knots**0, self._knots], ((0, 0), (2, 0)))
        free = null_space(np.stack((*beyond, at_rest[0], (OVER_SPAN - rest) @ raw / len(OVER_SPAN))))
        bends = distance[:, None] ** 1.5 * (bent @ free)
        roughness, vectors = eigh(*(f.T @ f / len(OVER_SPAN) for f in (bends, raw @ free)))
        # What each function is made of (terms, 2 + knots): one, x, and the knots' cubes.
        self._made_of = (free @ (vectors * np.sign(raw[-1] @ free @ vectors))).T
        # The first is even, and over speed costs next to nothing where it turns over at rest.
        self.smaller = np.minimum(1.0, np.sqrt(roughness[min(1, len(roughness) - 1)] / roughness))
        self._slopes = self._made_of @ np.r_[0.0, 1.0, 3.0 * np.maximum(rest - self._knots, 0.0) ** 2] / self._half

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
        apart = self._apart**2 * ((x - self._rest) ** 2 + self._near**2)
        between: Array = BETWEEN_KNOTS * apart * abs(bend)
        return between

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


def _beyond(x: Array, knots: Array) -> Array:
    """(..., knots), how far x is beyond each knot, and 0 before it."""
    beyond = x[..., None] - knots
    return (beyond + abs(beyond)) / 2.0


def _like(values: np.ndarray, x: Array) -> Any:
    """An array where x is one, a tensor where x is."""
    return values if isinstance(x, np.ndarray) else torch.as_tensor(values, dtype=x.dtype, device=x.device)
