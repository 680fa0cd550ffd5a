"""A forgotten nonlinearity."""

from __future__ import annotations

from pinn_cli.system.model_error.model_error import ModelError
from pinn_cli.system.structure import Structure


class LinearModelError(ModelError):
    """The model leaves the nonlinearity out and has m, c and k right (paper, 'linear' model)."""

    name = "linear"

    def structures(self, nominal: Structure) -> tuple[Structure, Structure]:
        """See :meth:`ModelError.chains`."""
        return nominal, nominal.linearised()
