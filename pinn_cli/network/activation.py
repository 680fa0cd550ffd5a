"""Activations with their derivatives, and the chain rule that carries a jet through them, forward and back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import comb
from typing import Any

import torch
from torch import Tensor

Activation = Callable[[Tensor, int], tuple[Tensor, ...]]
"""From z and an order (0 to 3) to s(z) and its derivatives by z up to that order, each shaped like z."""


def silu(z: Tensor, order: int) -> tuple[Tensor, ...]:
    """The sigmoid-weighted linear unit, z / (1 + exp(-z))."""
    s = torch.sigmoid(z)
    value = z * s
    if order == 0:
        return (value,)
    slope = torch.addcmul(s, s, s, value=-1.0)  # s'
    first = torch.addcmul(s, z, slope)
    if order == 1:
        return value, first
    second = torch.sub(z, value, alpha=2.0).add_(2.0).mul_(slope)  # s' (2 + z - 2 s z)
    if order == 2:
        return value, first, second
    odd = 1.0 - 2.0 * s  # s'' = s' odd
    return value, first, second, odd * (second + slope) - 2.0 * z * slope * slope


def tanh(z: Tensor, order: int) -> tuple[Tensor, ...]:
    """Hyperbolic tangent."""
    value = torch.tanh(z)
    if order == 0:
        return (value,)
    first = (value * value).neg_().add_(1.0)
    if order == 1:
        return value, first
    second = (value * first).mul_(-2.0)
    return (value, first, second) if order == 2 else (value, first, second, -2.0 * (first * first + value * second))


def sine(z: Tensor, order: int) -> tuple[Tensor, ...]:
    """Sine; its derivatives are as large as itself, which suits motions whose accelerations matter."""
    value = torch.sin(z)
    if order == 0:
        return (value,)
    first = torch.cos(z)
    return (value, first, -value, -first)[: order + 1]


ACTIVATIONS: dict[str, Activation] = {"silu": silu, "tanh": tanh, "sine": sine}


def propagate(activation: Activation, jet: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    """The jet of s(z(t)) from that of z(t).

    Args:
        activation: s.
        jet: z and its time derivatives up to order 0, 1 or 2, each of one shape.

    Returns:
        s, s' dz and s'' dz^2 + s' d2z, as many as came in: the first terms of Faa di Bruno's formula.
    """
    outputs: tuple[Tensor, ...] = _Propagation.apply(activation, *jet)
    return outputs[: len(jet)]


class _Propagation(torch.autograd.Function):
    """:func:`propagate` with its derivatives by the incoming jet written out.

    A change of z(t) changes s(z(t)) by the product s'(z(t)) dz(t), whose jet is Leibniz's. So all that gradients need
    are s' and its time derivatives. They are further outputs, kept from the way forward: autograd's own record of the
    formula moves so much more memory that a step of the paper's network takes a fifth longer.
    """

    generate_vmap_rule = True

    @staticmethod
    def forward(activation: Activation, *jet: Tensor) -> tuple[Tensor, ...]:
        value, slopes = _value_and_slopes(activation, jet)
        rates = [_sum_of_products(slopes[: k + 1], jet[k + 1 : 0 : -1], [comb(k, i) for i in range(k + 1)])
                 for k in range(len(jet) - 1)]  # fmt: skip
        return (value, *rates, *slopes)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
        ctx.activation, ctx.order = inputs[0], len(inputs) - 2
        slopes = output[len(inputs) - 1 :]
        ctx.mark_non_differentiable(*slopes)
        ctx.save_for_backward(*inputs[1:], *slopes)
        ctx.save_for_forward(*inputs[1:], *slopes)
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        slopes, order = _slopes(ctx), ctx.order
        back = []
        for j in range(order + 1):
            pairs = [(slopes[k - j], given, comb(k, j)) for k, given in enumerate(gradients[: order + 1])
                     if k >= j and given is not None]  # fmt: skip
            back.append(_sum_of_products(*zip(*pairs, strict=True)) if pairs else None)
        return None, *back

    @staticmethod
    def jvp(ctx: Any, _: None, *tangents: Tensor | None) -> tuple[Tensor | None, ...]:
        slopes, order = _slopes(ctx), ctx.order
        out: list[Tensor | None] = []
        for k in range(order + 1):
            pairs = [(slopes[k - j], given, comb(k, j)) for j, given in enumerate(tangents[: k + 1])
                     if given is not None]  # fmt: skip
            out.append(_sum_of_products(*zip(*pairs, strict=True)) if pairs else None)
        return (*out, *[None] * (order + 1))


def _value_and_slopes(activation: Activation, jet: tuple[Tensor, ...]) -> tuple[Tensor, tuple[Tensor, ...]]:
    """s, and s' with its time derivatives, as many as the jet has entries."""
    z, *rates = jet
    value, *slopes = activation(z, len(jet))
    if rates:
        first = slopes[1] * rates[0]
        if len(rates) > 1:
            slopes[2] = torch.addcmul(slopes[2] * rates[0].square(), slopes[1], rates[1])
        slopes[1] = first
    return value, tuple(slopes)


def _slopes(ctx: Any) -> tuple[Tensor, ...]:
    """What was kept, or the same with a graph behind it where gradients of gradients are wanted."""
    kept: tuple[Tensor, ...] = ctx.saved_tensors
    half = ctx.order + 1
    return _value_and_slopes(ctx.activation, kept[:half])[1] if torch.is_grad_enabled() else kept[half:]


def _sum_of_products(left: Sequence[Tensor], right: Sequence[Tensor], factors: Sequence[int]) -> Tensor:
    total = left[0] * right[0] if factors[0] == 1 else factors[0] * left[0] * right[0]
    for a, b, factor in zip(left[1:], right[1:], factors[1:], strict=True):
        total = torch.addcmul(total, a, b, value=factor)
    return total
