"""Parameters that are off by some per cent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
import torch

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import (
    LARGEST_LEGACY_SEED,
    LARGEST_WHOLE,
    entries,
    is_finite_number,
    one_of,
    whole_number,
)
from pinn_cli.system.model_error.model_error import ModelError
from pinn_cli.system.structure import Structure

KINDS_OF_DRAWS = ("independent", "authors")
# So that the seeds of a thousand connections are still seeds.
MOST_STRIDE = 10**6


class PerturbedModelError(ModelError):
    """The structure's c, k, kappa and mu are the nominal ones times 1 +- U(low, high); the model has the nominal ones.

    Args:
        seed: Of the draws.
        bounds: (low, high), relative; (0.05, 0.10) is the paper's.
        draws: ``independent``: one factor per parameter and connection. Each parameter has a stream of its own and each
            connection a place in it, so that a longer chain begins like a shorter one. ``authors``: the recipe behind
            the paper's table of perturbed parameters: connection i (from 0) draws its factor from legacy
            ``RandomState(seed + seed_stride i)``, seeded anew for each parameter, so that all parameters of a
            connection share one factor.
        seed_stride: Of the authors' recipe: 1 in their sparse recovery, 100 in their state-parameter scheme. Their seed
            is 43810.

    Raises:
        InputError: Naming ``model_error.<setting>``.
    """

    name = "perturbed"

    def __init__(
        self,
        seed: int = 0,
        bounds: Sequence[float] = (0.05, 0.10),
        draws: Annotated[str, KINDS_OF_DRAWS] = "independent",
        seed_stride: int = 1,
    ) -> None:
        self.low, self.high = _checked_bounds(bounds)
        self.draws = one_of("model_error.draws", draws, KINDS_OF_DRAWS)
        most = LARGEST_LEGACY_SEED if draws == "authors" else LARGEST_WHOLE
        self.seed = whole_number("model_error.seed", seed, most=most)
        self.seed_stride = whole_number("model_error.seed_stride", seed_stride, most=MOST_STRIDE)

    def structures(self, nominal: Structure) -> tuple[Structure, Structure]:
        """See :meth:`ModelError.chains`."""
        draw = self._authors_factors if self.draws == "authors" else self._independent_factors
        true = {
            name: value * torch.as_tensor(draw(name, value.shape[-1])).to(value)
            for name, value in nominal.parameters.items()
            if name != "m"
        }
        return nominal.with_parameters(**true), nominal

    def _independent_factors(self, name: str, ndof: int) -> np.ndarray:
        uniform = np.random.default_rng([self.seed, *name.encode()]).random((ndof, 2))
        size = self.low + (self.high - self.low) * uniform[:, 0]
        return 1.0 + np.where(uniform[:, 1] < 0.5, -size, size)

    def _authors_factors(self, name: str, ndof: int) -> np.ndarray:
        factors = np.empty(ndof)
        for i in range(ndof):
            generator = np.random.RandomState(self.seed + self.seed_stride * i)
            size = generator.uniform(self.low, self.high)
            factors[i] = 1.0 + (size if generator.randint(0, 2) else -size)
        return factors


def _checked_bounds(bounds: Sequence[float]) -> tuple[float, float]:
    pair = entries(bounds)
    if len(pair) != 2 or not all(is_finite_number(x) for x in pair) or not 0 <= pair[0] <= pair[1] < 1:
        raise InputError("model_error.bounds", bounds, "[low, high] with 0 <= low <= high < 1", "0.05 is five per cent")
    return float(pair[0]), float(pair[1])
