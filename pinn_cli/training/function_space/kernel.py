"""The residuals of a multilayer perceptron linearised in all its weights, without their Jacobian.

Residual r depends on the weights W_l of layer l through z_l^q = W_l a_l^q (+ bias), where q counts value, first and
second time derivative, and a_l^q is what the layer gets. So dr/dW_l is the sum over q of d_l^q (x) a_l^q, with
d_l^q = dr/dz_l^q, and

    J J' = sum over l, q, p of (d_l^q . d_l^p) (a_l^q . a_l^p + [q = p = 0, the bias])

elementwise in pairs of residuals: products of narrow matrices, however many weights there are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from pinn_cli.network.activation import ACTIVATIONS, propagate
from pinn_cli.network.base import States
from pinn_cli.network.mlp import MlpNetwork

# Rows and columns that are made symmetric at a time.
BLOCK = 512

Layers = list[tuple[Tensor, Tensor]]
"""A direction or position in the space of weights: weight and bias of every layer."""


@dataclass(frozen=True, eq=False)
class Block:
    """The residuals that look at the motion at the same P times.

    Attributes:
        inputs: By layer, (Q, P, fan in), what it gets and its time derivatives.
        sensitivity: By layer, (Q, R, P, fan out): derivative of residual (row, point) by what the layer gives.
    """

    inputs: list[Tensor]
    sensitivity: list[Tensor]

    @property
    def rows(self) -> int:
        """R."""
        return self.sensitivity[0].shape[1]

    @property
    def size(self) -> int:
        """R P."""
        return self.rows * self.sensitivity[0].shape[2]


def layers(network: MlpNetwork) -> Layers:
    """The network's own, detached."""
    return [(w.detach(), b.detach()) for w, b in zip(network.weights, network.biases, strict=True)]


def linearised(
    network: MlpNetwork, time: Tensor, residuals: Callable[[States], Tensor]
) -> tuple[Block, Tensor, States]:
    """Linearise residuals at the given times.

    Args:
        network: At which weights.
        time: (P,), s.
        residuals: From the motion at these times to (R, P), each of which depends on the motion at its own time only.

    Returns:
        The linearisation, the residuals (R, P) and the motion, both detached.
    """
    inputs, outputs = _forward(network, time)
    states = _states(network, outputs[-1])
    values = residuals(states)
    gradients = [torch.autograd.grad(row.sum(), outputs, retain_graph=True) for row in values]
    sensitivity = [torch.stack(by_row, 1) for by_row in zip(*gradients, strict=True)]
    continuity = None if states.continuity is None else states.continuity.detach()
    motion = States(states[0].detach(), states[1].detach(), states[2].detach(), continuity)
    return Block([a.detach() for a in inputs], sensitivity), values.detach(), motion


def _forward(network: MlpNetwork, time: Tensor) -> tuple[list[Tensor], list[Tensor]]:
    """What every layer gets, and what it gives before its activation, (Q, P, width) each, with a graph."""
    order = 2 if network.continuity == "exact" else 1
    activation = ACTIVATIONS[network.activation]
    arriving = torch.stack(network.input_jet(time, order))
    inputs, outputs = [], []
    for weight, bias in zip(network.weights, network.biases, strict=True):
        inputs.append(arriving)
        given = functional.linear(arriving, weight.detach().requires_grad_())
        outputs.append(given + functional.pad(bias.detach()[None, None], (0, 0, 0, 0, 0, order)))
        arriving = torch.stack(propagate(activation, tuple(outputs[-1].unbind())))
    return inputs, outputs


def _states(network: MlpNetwork, output: Tensor) -> States:
    """The motion from the last layer's outputs, (Q, P, channels n)."""
    jet = [network.amplitude / network.span**q * x for q, x in enumerate(output.unbind())]
    if network.continuity == "exact":
        return States(jet[0], jet[1], jet[2], None)
    (u, v), (du, dv) = (x.tensor_split(2, -1) for x in jet)
    return States(u, v, dv, du - v)


def kernel(blocks: list[Block]) -> Tensor:
    """J J' over all blocks' residuals, in their order, (M, M)."""
    sizes = [block.size for block in blocks]
    out = blocks[0].inputs[0].new_empty(sum(sizes), sum(sizes))
    places = [slice(sum(sizes[:i]), sum(sizes[: i + 1])) for i in range(len(sizes))]
    for i, (here, rows) in enumerate(zip(blocks, places, strict=True)):
        _symmetric_part(here, out[rows, rows])
        for there, columns in zip(blocks[:i], places[:i], strict=True):
            out[rows, columns] = cross_kernel(here, there)
            out[columns, rows] = out[rows, columns].T
    return out


def _symmetric_part(block: Block, out: Tensor) -> None:
    """The kernel of one block with itself, written to (M, M): half of the products, and their transposes."""
    half = _products(block, block, lambda q, p: 1.0 if p > q else 0.5 if p == q else 0.0)
    for start in range(0, len(half), BLOCK):
        here, rest = slice(start, start + BLOCK), slice(start, None)
        both = half[here, rest] + half[rest, here].T
        out[here, rest], out[rest, here] = both, both.T


def _products(here: Block, there: Block, factor: Callable[[int, int], float]) -> Tensor:
    """Sum over layers and pairs of derivatives, each times a factor, (M_here, M_there)."""
    points = [block.inputs[0].shape[1] for block in (here, there)]
    total = here.inputs[0].new_zeros(here.rows, points[0], there.rows, points[1])
    for layer in range(len(here.inputs)):
        left, right = here.sensitivity[layer], there.sensitivity[layer]
        for q in range(len(left)):
            for p in range(len(right)):
                if factor(q, p):
                    gram = here.inputs[layer][q] @ there.inputs[layer][p].T + float(q == p == 0)
                    product = left[q].flatten(0, 1) @ right[p].flatten(0, 1).T
                    total.addcmul_(product.view(total.shape), gram[None, :, None, :], value=factor(q, p))
    return total.view(here.size, there.size)


def cross_kernel(here: Block, there: Block) -> Tensor:
    """J_here J_there', (M_here, M_there)."""
    return _products(here, there, lambda q, p: 1.0)


def prior_variance(block: Block) -> Tensor:
    """The diagonal of the kernel of a block with itself, (R, P)."""
    total = block.sensitivity[0].new_zeros(block.sensitivity[0].shape[1:3])
    for a, d in zip(block.inputs, block.sensitivity, strict=True):
        gram = torch.einsum("qpi,spi->qsp", a, a)
        gram[0, 0] += 1.0
        total += torch.einsum("qrpo,srpo,qsp->rp", d, d, gram)
    return total


def pulled_back(block: Block, values: Tensor) -> Layers:
    """J' times values (R, P) of the residuals."""
    out = []
    for a, d in zip(block.inputs, block.sensitivity, strict=True):
        weighted = torch.einsum("qrpo,rp->qpo", d, values)
        out.append((torch.einsum("qpo,qpi->oi", weighted, a), weighted[0].sum(0)))
    return out


def pushed_forward(block: Block, direction: Layers) -> Tensor:
    """J times a direction of the weights, (R, P)."""
    total = block.sensitivity[0].new_zeros(block.sensitivity[0].shape[1:3])
    for a, d, (weight, bias) in zip(block.inputs, block.sensitivity, direction, strict=True):
        given = functional.linear(a, weight)
        given[0] += bias
        total += torch.einsum("qrpo,qpo->rp", d, given)
    return total
