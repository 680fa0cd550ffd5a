"""What ``training.weights`` may be."""

from __future__ import annotations

from collections.abc import Mapping

from pinn_cli.settings.errors import InputError
from pinn_cli.training.gradient.equalised_weights import EqualisedWeights
from pinn_cli.training.gradient.loss_weights import LossWeights, Weights


def read_weights(given: Mapping[str, float | None] | str | None) -> Weights:
    """Loss weights from a setting: ``equalised``, or fixed ones by name.

    Raises:
        InputError: Anything else.
    """
    if given == "equalised":
        return EqualisedWeights()
    if given is None or isinstance(given, Mapping):
        return LossWeights.read(given or {})
    names = ", ".join(LossWeights.__dataclass_fields__)
    raise InputError("training.weights", given, f"equalised, or numbers for {names}")
