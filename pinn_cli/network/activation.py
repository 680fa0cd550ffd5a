"""Activations with their derivatives, and the chain rule that carries a jet through them, forward and back."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from math import comb
from typing import Any

import torch
from torch import Tensor

Activation = Callable[[Tensor], Iterator[Tensor]]
"""From z to s(z) and its first three derivatives by z, one after the other, each shaped like z."""


def silu(z: Tensor) -> Iterator[Tensor]:
    """The sigmoid-weighted linear unit, z / (1 + exp(-z))."""
    s = torch.sigmoid(z)
    value = z * s
    yield value
    slope = torch.addcmul(s, s, s, value=-1.0)  # s'
    yield torch.addcmul(s, z, slope)
    second = torch.sub(z, value, alpha=2.0).add_(2.0).mul_(slope)  # s' (2 + z - 2 s z)
    yield second
    odd = 1.0 - 2.0 * s  # s'' = s' odd
    yield odd * (second + slope) - 2.0 * z * slope * slope


def tanh(z: Tensor) -> Iterator[Tensor]:
    """Hyperbolic tangent."""
    value = torch.tanh(z)
    yield value
    first = (value * value).neg_().add_(1.0)
    yield first
    second = (value * first).mul_(-2.0)
    yield second
    yield -2.0 * (first * first + value * second)


def sine(z: Tensor) -> Iterator[Tensor]:
    """Sine; its derivatives are as large as itself, which suits motions whose accelerations matter."""
    value = torch.sin(z)
    yield value
    first = torch.cos(z)
    yield from (first, -value, -first)


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
        rates = [_sum_of_products((slopes[i], jet[k + 1 - i], comb(k, i)) for i in range(k + 1))
                 for k in range(len(jet) - 1)]  # fmt: skip
        return (value, *rates, *slopes)  # type: ignore[arg-type]

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
        incoming = [(k, given) for k, given in enumerate(gradients[: order + 1]) if given is not None]
        back = [_sum_of_products((slopes[k - j], given, comb(k, j)) for k, given in incoming if k >= j)
                for j in range(order + 1)]  # fmt: skip
        return None, *back

    @staticmethod
    def jvp(ctx: Any, _: None, *tangents: Tensor | None) -> tuple[Tensor | None, ...]:
        slopes, order = _slopes(ctx), ctx.order
        incoming = [(j, given) for j, given in enumerate(tangents) if given is not None]
        out = [_sum_of_products((slopes[k - j], given, comb(k, j)) for j, given in incoming if j <= k)
               for k in range(order + 1)]  # fmt: skip
        return (*out, *[None] * (order + 1))


def _value_and_slopes(activation: Activation, jet: tuple[Tensor, ...]) -> tuple[Tensor, tuple[Tensor, ...]]:
    """s, and s' with its time derivatives, as many as the jet has entries."""
    z, *rates = jet
    value, *slopes = islice(activation(z), len(jet) + 1)
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


def _sum_of_products(terms: Iterable[tuple[Tensor, Tensor, int]]) -> Tensor | None:
    """Of two tensors and a factor each; None without any."""
    total = None
    for a, b, factor in terms:
        if total is None:
            total = a * b if factor == 1 else factor * a * b
        else:
            total = torch.addcmul(total, a, b, value=factor)
    return total
