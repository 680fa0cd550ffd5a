"""Products with the derivatives of residuals by weights, many at a time."""

from __future__ import annotations

import torch
from torch import Tensor

from pinn_cli.training.function_space.kernel import Block


class LayerProduct:
    """A block's residuals by the weights between what a layer gets and what it, or a later one, gives.

    The derivative of residual (row, point) by the weight from input i to output o is the sum over q, value and time
    derivatives, of sensitivity (q, row, point, o) times input (q, point, i).

    Args:
        inputs: (Q, P, I + 1), the one that a bias stands on last, see :func:`with_constant`.
        sensitivity: (Q, R, P, O).
    """

    def __init__(self, inputs: Tensor, sensitivity: Tensor) -> None:
        derivatives, rows, points, outputs = sensitivity.shape
        self.inputs = inputs
        self.shape = (derivatives, rows, points, outputs)
        self.by_point = sensitivity.permute(2, 1, 0, 3).reshape(points, rows, derivatives * outputs)

    def forward(self, weights: Tensor) -> Tensor:
        """(R P, k), by a change (O, I + 1, k) of the weights, the bias last."""
        derivatives, _, points, outputs = self.shape
        count = weights.shape[2]
        flat = weights.movedim(1, 0).reshape(weights.shape[1], outputs * count)
        given = (self.inputs @ flat).movedim(1, 0).reshape(points, derivatives * outputs, count)
        return (self.by_point @ given).movedim(1, 0).reshape(-1, count)

    def backward(self, values: Tensor) -> Tensor:
        """(O, I + 1, k), the transposed times (R P, k)."""
        derivatives, rows, points, outputs = self.shape
        count = values.shape[1]
        by_point = values.view(rows, points, count).movedim(1, 0)
        given = (self.by_point.mT @ by_point).view(points, derivatives, outputs * count).movedim(1, 0)
        flat = self.inputs.flatten(0, 1).T @ given.reshape(derivatives * points, outputs * count)
        return flat.view(-1, outputs, count).movedim(1, 0)


class Products:
    """Products with J and J', and with those of the linear model of the units, made once for a linearisation.

    Args:
        blocks: The residuals'.
    """

    def __init__(self, blocks: list[Block]) -> None:
        self.blocks = blocks
        self.sizes = [block.size for block in blocks]
        self.by_layer = [
            [LayerProduct(with_constant(a), d) for a, d in zip(block.inputs, block.sensitivity, strict=True)]
            for block in blocks
        ]
        self.linear = [
            LayerProduct(each[0].inputs, block.sensitivity[-1])
            for each, block in zip(self.by_layer, blocks, strict=True)
        ]

    def kernel(self, values: Tensor) -> Tensor:
        """J J' times (M, k)."""
        pieces = values.split(self.sizes)
        by_layer = []
        for each in zip(*self.by_layer, strict=True):
            pulled = sum_of([product.backward(piece) for product, piece in zip(each, pieces, strict=True)])
            by_layer.append(torch.cat([product.forward(pulled) for product in each]))
        return sum_of(by_layer)

    def to_features(self, values: Tensor) -> Tensor:
        """(outputs, F, k) from (M, k), F features and a constant."""
        pieces = values.split(self.sizes)
        return sum_of([product.backward(piece) for product, piece in zip(self.linear, pieces, strict=True)])

    def from_features(self, coefficients: Tensor) -> Tensor:
        """(M, k) from (outputs, F, k)."""
        return torch.cat([product.forward(coefficients) for product in self.linear])


def with_constant(inputs: Tensor) -> Tensor:
    """(Q, P, F), the features and a constant, from (Q, P, F - 1)."""
    one = inputs.new_zeros(*inputs.shape[:2], 1)
    one[0] = 1.0
    return torch.cat((inputs, one), 2)


def sum_of(tensors: list[Tensor]) -> Tensor:
    """Their sum."""
    total = tensors[0]
    for tensor in tensors[1:]:
        total = total + tensor
    return total
