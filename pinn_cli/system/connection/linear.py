"""No nonlinearity."""

from __future__ import annotations

from collections.abc import Mapping

from pinn_cli.system.array_namespace import Array, namespace
from pinn_cli.system.connection.nonlinearity import Nonlinearity


class Linear(Nonlinearity):
    """r_n = 0: the connection is its spring and its dashpot."""

    name = "linear"
    parameters: tuple[str, ...] = ()

    def force(self, e: Array, de: Array, parameters: Mapping[str, Array]) -> Array:
        """See :meth:`Nonlinearity.force`."""
        return namespace(e).zeros_like(e)
