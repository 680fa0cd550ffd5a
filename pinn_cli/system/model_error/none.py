"""No model error."""

from __future__ import annotations

from pinn_cli.system.model_error.model_error import ModelError
from pinn_cli.system.structure import Structure


class NoModelError(ModelError):
    """The model is the structure."""

    name = "none"

    def structures(self, nominal: Structure) -> tuple[Structure, Structure]:
        """See :meth:`ModelError.chains`."""
        return nominal, nominal
