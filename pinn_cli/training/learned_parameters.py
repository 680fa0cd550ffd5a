"""The chain's parameters as a module, of which the uncertain ones are learned by gradients."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from pinn_cli.scheme.problem import Problem
from pinn_cli.system.parameters import ParameterVector
from pinn_cli.training.estimate import ParameterEstimate


class LearnedParameters(nn.Module):
    """Every parameter of the chain; those that may move start at their prescribed values.

    Attributes:
        moved: (p,), distance of each uncertain parameter from its prescribed value, over its order of magnitude: a step
            of 0.01 is about one per cent, whatever the unit.
    """

    unit: Tensor
    prior_std: Tensor
    lower: Tensor

    def __init__(self, problem: Problem, dtype: torch.dtype) -> None:
        super().__init__()
        self.uncertain = problem.uncertain
        self.vector = ParameterVector(problem.structure.parameters, self.uncertain)
        for name, values in self.vector.nominal.items():
            self.register_buffer(f"nominal_{name}", values.detach().to(dtype))
        unit, spread, lower = (
            torch.tensor([getattr(p, name) for p in self.uncertain], dtype=torch.float64)
            for name in ("step", "prior_std", "lower")
        )
        self.register_buffer("unit", unit.to(dtype))
        self.register_buffer("prior_std", spread.to(dtype))
        self.register_buffer("lower", (lower / unit).to(dtype))
        self.moved = nn.Parameter(torch.zeros(self.count, dtype=dtype))

    @property
    def count(self) -> int:
        """Number of parameters that may move, p."""
        return len(self.uncertain)

    def forward(self) -> dict[str, Tensor]:
        """Every parameter by kind, at the nearest point within the bounds."""
        nominal = {name: self.get_buffer(f"nominal_{name}") for name in self.vector.nominal}
        return self.vector.values(self.unit * self._inside, nominal)

    @property
    def _inside(self) -> Tensor:
        """(p,), without a gradient beyond a bound."""
        return self.moved.clamp(min=self.lower)

    @torch.no_grad()
    def respect_bounds(self) -> None:
        """Put parameters that a step has taken below their least value back onto it."""
        self.moved.clamp_(min=self.lower)

    def prior(self) -> Tensor:
        """Sum of squared distances from the prescribed values, in prior standard deviations."""
        return (self.unit / self.prior_std * self._inside).square().sum()

    def estimates(self) -> list[ParameterEstimate]:
        """Where the parameters are now; a gradient method knows no standard deviations."""
        distance = (self.unit * self.moved).detach().cpu().double().tolist()
        held = (self.moved <= self.lower).cpu().tolist()
        nothing = (math.nan, math.nan, math.nan)
        return [
            ParameterEstimate(p, p.value(p.lower if h else d), *nothing, h)
            for p, d, h in zip(self.uncertain, distance, held, strict=True)
        ]
