"""Weights lambda of the loss terms: fixed ones, and those under which every term pulls equally hard at the start."""

from __future__ import annotations

from collections.abc import Mapping

import torch

from pinn_cli.network.base import Network
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import non_negative_number
from pinn_cli.training.gradient.losses import Losses
from pinn_cli.training.learned_parameters import LearnedParameters

# The paper's. Those of physics are of the DOFs whose force is measured, and of the others too unless they are given.
FIXED: dict[str, float | None] = {"observation": 1.0, "continuity": 10.0, "physics": 100.0, "unforced": None}
EQUALISED = "equalised"
# The terms of the equations of motion, whose weights grow from stage to stage.
PHYSICS = ("forced", "unforced")


def checked_weights(given: Mapping[str, float | None] | str | None) -> dict[str, float | None] | str:
    """Fixed weights, completed by the paper's, or ``equalised``.

    Raises:
        InputError: Anything else.
    """
    if given == EQUALISED:
        return EQUALISED
    if given is not None and not isinstance(given, Mapping):
        raise InputError("training.weights", given, f"{EQUALISED}, or numbers for {', '.join(FIXED)}")
    weights = dict(FIXED)
    for name, value in (given or {}).items():
        if name not in FIXED:
            raise InputError(f"training.weights.{name}", value, f"one of {', '.join(FIXED)}")
        if name != "unforced" or value is not None:
            non_negative_number(f"training.weights.{name}", value)
        weights[name] = value
    return weights


def fixed_weights(given: Mapping[str, float | None]) -> dict[str, float]:
    """By term of :meth:`Losses.terms`."""
    by_term = {
        "observation": given["observation"],
        "continuity": given["continuity"],
        "forced": given["physics"],
        "unforced": given["physics"] if given["unforced"] is None else given["unforced"],
        "prior": 1.0,
    }
    return {name: float(weight) for name, weight in by_term.items() if weight is not None}


def equalised_weights(losses: Losses, network: Network, parameters: LearnedParameters) -> dict[str, float]:
    """Weights with which every term's gradient by the network's weights has the norm of the observations'.

    Wang, Teng & Perdikaris 2021 ("Understanding and mitigating gradient flow pathologies in physics-informed neural
    networks") and Wang et al. 2023 ("An expert's guide to training physics-informed neural networks", algorithm 1) do
    so again and again; here it is done once, since quasi-Newton methods and line searches need one loss. A term without
    a gradient (continuity, where a network begins at zero) keeps its fixed weight, and so does the prior.
    """
    weights, norms = fixed_weights(FIXED), {}
    for name, term in losses.terms(network, parameters).items():
        if term.requires_grad:
            parts = torch.autograd.grad(
                term, list(network.parameters()), retain_graph=True, allow_unused=True, materialize_grads=True
            )
            norms[name] = float(torch.stack([part.norm() for part in parts]).norm())
    for name, norm in norms.items():
        if name != "prior" and norm > 0 and norms["observation"] > 0:
            weights[name] = norms["observation"] / norm
    return weights
