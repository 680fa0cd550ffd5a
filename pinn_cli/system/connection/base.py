"""What a nonlinearity of a connection is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    import numpy as np

    from pinn_cli.system.array_namespace import Array


class Nonlinearity(ABC):
    """The nonlinear part of a connection's internal force, r_i = c_i de_i + k_i e_i + r_n(e_i, de_i).

    A new one is a file here and a file in ``conf/system``; nothing else changes.

    Attributes:
        name: What the tables call it.
        parameters: Names of its parameters, beyond m, c and k.
        stiffness_parameter: The one that fills the paper's K_n (its force depends on e alone), if there is one.
        damping_parameter: The one that fills the paper's C_n, if there is one.
        nonnegative: Parameters that make no physical sense below zero.
        optional: Parameters that a connection may be without, beyond ``parameters``.
    """

    name: ClassVar[str]
    parameters: tuple[str, ...]
    stiffness_parameter: ClassVar[str | None] = None
    damping_parameter: ClassVar[str | None] = None
    nonnegative: ClassVar[tuple[str, ...]] = ("c", "k")
    optional: ClassVar[tuple[str, ...]] = ()

    @property
    def titles(self) -> Mapping[str, str]:
        """What a figure calls each of its parameters; one that is left out goes by its symbol."""
        return {}

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of each of its parameters, powers as ``m^3``; one that is left out is printed without."""
        return {}

    def of_given(self, given: Collection[str]) -> Nonlinearity:
        """The law with those of its optional parameters that a connection has.

        Args:
            given: Names of the parameters that the user has written down.
        """
        return self

    def stiffness_at_rest(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray | float:
        """dr_n/de of a connection at rest, N/m, which with k says how long the steps of a simulation may be.

        Args:
            parameters: As :meth:`force` takes them.
        """
        return 0.0

    def damping_at_rest(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray | float:
        """dr_n/d(de) of a connection at rest, N s/m, which with c says how long the steps of a simulation may be."""
        return 0.0

    @abstractmethod
    def force(self, e: Array, de: Array, parameters: Mapping[str, Array]) -> Array:
        """Nonlinear internal force of every connection, N.

        Write it with operators, so that numpy arrays and torch tensors both pass through it, and elementwise, so that
        any leading dimensions do.

        Args:
            e: Elongation of every connection (..., ndof), m.
            de: Its rate (..., ndof), m/s.
            parameters: Every parameter of the chain, each broadcastable against e.

        Returns:
            (..., ndof), N.
        """
