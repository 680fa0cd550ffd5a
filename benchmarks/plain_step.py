"""A plain step of the paper's training: one reverse pass per output for the time derivatives, DOF by DOF.

This is what `python -m benchmarks.epochs` compares with. It follows the paper's algorithm 1 and the way its authors
compute derivatives: the network's 2 n outputs are differentiated by time one after the other, each by a reverse pass
whose graph is kept for the weights' gradient.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from pinn_cli.network.mlp import MlpNetwork
from pinn_cli.network.network import States

ACTIVATIONS = {"silu": functional.silu, "tanh": torch.tanh, "sine": torch.sin}


class PlainNetwork:
    """The states of an MLP with separate outputs for displacement and velocity, on the same weights.

    Args:
        network: Whose weights are used.
    """

    def __init__(self, network: MlpNetwork) -> None:
        assert network.continuity == "penalised"
        self.network, self.activation = network, ACTIVATIONS[network.activation]

    def outputs(self, time: Tensor) -> Tensor:
        """(N, 2 n), displacements and velocities."""
        network = self.network
        hidden = ((time - network.start) / network.span)[:, None]
        layers = list(zip(network.weights, network.biases, strict=True))
        for weight, bias in layers[:-1]:
            hidden = self.activation(functional.linear(hidden, weight, bias))
        return network.amplitude * functional.linear(hidden, *layers[-1])

    def __call__(self, time: Tensor) -> States:
        """Motion at the given times (N,), s."""
        n = self.network.ndof
        time = time.clone().requires_grad_()
        outputs = self.outputs(time)
        rates = []
        for output in range(2 * n):
            column = outputs[:, output]
            (rate,) = torch.autograd.grad(column, time, torch.ones_like(column), create_graph=True)
            rates.append(rate)
        displacement_rate, acceleration = torch.stack(rates[:n], dim=1), torch.stack(rates[n:], dim=1)
        displacement, velocity = outputs[:, :n], outputs[:, n:]
        return States(displacement, velocity, acceleration, displacement_rate - velocity)
