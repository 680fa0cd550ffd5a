"""Activations with their derivatives, and the chain rule that carries a jet through them."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

Activation = Callable[[Tensor, int], tuple[Tensor, ...]]
"""From z and an order (0, 1 or 2) to s(z) and its derivatives by z up to that order, each shaped like z."""


def silu(z: Tensor, order: int) -> tuple[Tensor, ...]:
    """The sigmoid-weighted linear unit, z / (1 + exp(-z))."""
    s = torch.sigmoid(z)
    value = z * s
    if order == 0:
        return (value,)
    slope = s * (1.0 - s)
    first = s + z * slope
    return (value, first) if order == 1 else (value, first, slope * (2.0 + z * (1.0 - 2.0 * s)))


def tanh(z: Tensor, order: int) -> tuple[Tensor, ...]:
    """Hyperbolic tangent."""
    value = torch.tanh(z)
    if order == 0:
        return (value,)
    first = 1.0 - value * value
    return (value, first) if order == 1 else (value, first, -2.0 * value * first)


def sine(z: Tensor, order: int) -> tuple[Tensor, ...]:
    """Sine; its derivatives are as large as itself, which suits motions whose accelerations matter."""
    value = torch.sin(z)
    return (value, torch.cos(z), -value)[: order + 1]


ACTIVATIONS: dict[str, Activation] = {"silu": silu, "tanh": tanh, "sine": sine}


def propagate(activation: Activation, jet: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    """The jet of s(z(t)) from that of z(t).

    Args:
        activation: s.
        jet: z and its time derivatives up to order 0, 1 or 2, each of one shape.

    Returns:
        s, s' dz and s'' dz^2 + s' d2z, as many as came in: the first terms of Faa di Bruno's formula.
    """
    z, *rates = jet
    value, *slopes = activation(z, len(rates))
    if not rates:
        return (value,)
    first = slopes[0] * rates[0]
    return (value, first) if len(rates) == 1 else (value, first, slopes[1] * rates[0].square() + slopes[0] * rates[1])
