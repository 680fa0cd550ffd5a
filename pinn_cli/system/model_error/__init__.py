"""Model errors, one per file."""

from pinn_cli.system.model_error.linear import LinearModelError
from pinn_cli.system.model_error.model_error import ModelError
from pinn_cli.system.model_error.none import NoModelError
from pinn_cli.system.model_error.perturbed import PerturbedModelError

__all__ = ["LinearModelError", "ModelError", "NoModelError", "PerturbedModelError"]
