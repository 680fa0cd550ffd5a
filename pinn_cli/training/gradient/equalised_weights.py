"""Loss weights under which every term pulls equally hard at the start."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from pinn_cli.network.base import Network
from pinn_cli.training.gradient.learned_parameters import LearnedParameters
from pinn_cli.training.gradient.loss_weights import LossWeights, Weights
from pinn_cli.training.gradient.losses import Losses


class EqualisedWeights(Weights):
    """Every term's gradient by the network's weights has, where training begins, the norm of the observations'.

    Wang, Teng & Perdikaris 2021 ("Understanding and mitigating gradient flow pathologies in physics-informed neural
    networks") and Wang et al. 2023 ("An expert's guide to training physics-informed neural networks", algorithm 1) do
    so again and again; here it is done once, since quasi-Newton methods and line searches need one loss. A term without
    a gradient there (continuity, where a network begins at zero) keeps its fixed weight, and so does the prior.
    """

    def __init__(self) -> None:
        self.found = LossWeights().by_term(1.0)

    def begin_stage(self, losses: Losses, network: Network, parameters: LearnedParameters, stage: int) -> None:
        """See :meth:`Weights.begin_stage`."""
        if stage > 0:
            return
        norms = _gradient_norms(losses, network, parameters)
        for name, norm in norms.items():
            if name != "prior" and norm > 0 and norms["observation"] > 0:
                self.found[name] = norms["observation"] / norm

    def by_term(self, physics_factor: float) -> dict[str, float]:
        """See :meth:`Weights.by_term`."""
        return {n: w * (physics_factor if n in ("forced", "unforced") else 1.0) for n, w in self.found.items()}

    def state_dict(self) -> dict[str, Any]:
        """See :meth:`Weights.state_dict`."""
        return dict(self.found)

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """See :meth:`Weights.load_state_dict`."""
        self.found = dict(state)


def _gradient_norms(losses: Losses, network: Network, parameters: LearnedParameters) -> dict[str, float]:
    """Norm of every unweighted term's gradient by the network's weights."""
    weights = list(network.parameters())
    norms = {}
    for name, term in losses.terms(network, parameters).items():
        if term.requires_grad:
            parts = torch.autograd.grad(term, weights, retain_graph=True, allow_unused=True, materialize_grads=True)
            norms[name] = float(torch.stack([part.norm() for part in parts]).norm())
    return norms
