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
    """J J' over all blocks' residuals, in their order, (M, M): its lower triangle; above it there may be zeros."""
    sizes = [block.size for block in blocks]
    out = blocks[0].inputs[0].new_zeros(sum(sizes), sum(sizes))
    places = [slice(sum(sizes[:i]), sum(sizes[: i + 1])) for i in range(len(sizes))]
    for i, (here, rows) in enumerate(zip(blocks, places, strict=True)):
        for there, columns in zip(blocks[:i], places[:i], strict=True):
            _fill(out[rows, columns], here, there, lower=False)
        _fill(out[rows, rows], here, here, lower=True)
    return out


def cross_kernel(here: Block, there: Block) -> Tensor:
    """J_here J_there', (M_here, M_there)."""
    out = here.inputs[0].new_empty(here.size, there.size)
    _fill(out, here, there, lower=False)
    return out


def _fill(out: Tensor, here: Block, there: Block, lower: bool) -> None:
    """Write the kernel of two blocks, (M_here, M_there), one pair of rows after the other, which fits a cache.

    Args:
        out: Where to.
        here: The block of the rows.
        there: That of the columns.
        lower: Whether the pairs in which the second row comes after the first are left as they are.
    """
    terms = _terms(here, there)
    points, others = here.inputs[0].shape[1], there.inputs[0].shape[1]
    total, product = (out.new_empty(points, others) for _ in range(2))
    for row in range(here.rows):
        for other in range(row + 1 if lower else there.rows):
            total.zero_()
            for term in terms:
                units = term.units(row, other)
                if units is not None:
                    torch.mm(term.left[row][:, units], term.right[other][:, units].T, out=product)
                    total.addcmul_(product, term.gram)
            out[row * points : (row + 1) * points, other * others : (other + 1) * others] = total


@dataclass(frozen=True, eq=False)
class _Term:
    """One layer and pair of derivatives in the kernel of two blocks.

    Attributes:
        left, right: (R, P, fan out), their sensitivities.
        gram: (P_left, P_right), products of what the layer gets.
        active: Of both, by row, the units that it depends on.
    """

    left: Tensor
    right: Tensor
    gram: Tensor
    active: tuple[list[set[int]], list[set[int]]]

    def units(self, row: int, other: int) -> slice | list[int] | None:
        """The units that both rows depend on: an equation of motion looks at three outputs; None: there are none."""
        both = self.active[0][row] & self.active[1][other]
        return slice(None) if len(both) == self.left.shape[2] else sorted(both) or None


def _terms(here: Block, there: Block) -> list[_Term]:
    terms = []
    for a, b, left, right in zip(here.inputs, there.inputs, here.sensitivity, there.sensitivity, strict=True):
        active = [[_active(d) for d in side] for side in (left, right)]
        for q in range(len(left)):
            for p in range(len(right)):
                gram = a[q] @ b[p].T + float(q == p == 0)
                terms.append(_Term(left[q], right[p], gram, (active[0][q], active[1][p])))
    return terms


def _active(sensitivity: Tensor) -> list[set[int]]:
    """By row of (R, P, fan out), which units it depends on anywhere."""
    return [set(units.nonzero()[:, 0].tolist()) for units in sensitivity.ne(0).any(1)]


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
