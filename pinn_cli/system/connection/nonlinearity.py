"""What a nonlinearity of a connection is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from typing import ClassVar

import numpy as np

from pinn_cli.system.array_namespace import Array

# What stretches a connection, in the order in which a response has it; of what a law may be a function.
OVER = ("elongation", "speed")


class Nonlinearity(ABC):
    """The nonlinear part of a connection's internal force, r_i = c_i de_i + k_i e_i + r_n(e_i, de_i).

    A new one is a file here and a file in ``conf/system``; nothing else changes.

    Attributes:
        name: What the tables call it.
        parameters: Names of its parameters, beyond m, c and k.
        states: How many functions of time a connection remembers, see :class:`Hysteresis`.
        titles: What a figure calls each of its parameters; one that is left out goes by its symbol.
        units: Unit of each of its parameters, powers as ``m^3``; one that is left out is printed without.
        nonnegative: Parameters that make no physical sense below zero.
        optional: Parameters that a connection may be without, beyond ``parameters``.
        curves: Kinds of parameters that are the terms of a curve, of every curve: the record tells how rough each is.
        spans: Between which elongations, m, and which speeds, m/s, the law is one; beyond, it is a guess.
        reversal_speed: Speed of the elongation over which the force turns when the motion does, m/s, 0 where it has a
            corner there; None: the force is smooth. A simulation divides the steps in which that happens.
        is_stiff: Whether a simulation takes implicit steps, however slow the motion is.
    """

    name: ClassVar[str]
    parameters: tuple[str, ...]
    states: ClassVar[int] = 0
    titles: Mapping[str, str] = {}
    units: Mapping[str, str] = {}
    nonnegative: tuple[str, ...] = ("c", "k")
    optional: ClassVar[tuple[str, ...]] = ()
    curves: Sequence[Sequence[str]] = ()
    spans: Mapping[str, tuple[float, float]] = {}
    reversal_speed: float | None = None
    is_stiff: bool = False

    def of_given(self, given: Collection[str]) -> Nonlinearity:
        """The law with those of its optional parameters that a connection has, by the names that are written down."""
        return self

    def turning_over(self, speed: float) -> Nonlinearity:
        """The law that an estimator solves: one that turns at once does so over a speed, m/s."""
        return self

    def moving_by(self, elongation: float) -> Nonlinearity:
        """The law with states that are counted at the size of a record's motion, m, where nobody said otherwise."""
        return self

    def bending_at(self, parameters: Mapping[str, np.ndarray]) -> Nonlinearity:
        """The law whose curves can bend where they do at these parameters, each (connections,)."""
        return self

    def terms_of(self, other: Nonlinearity, parameters: Mapping[str, np.ndarray]) -> Mapping[str, np.ndarray]:
        """Terms of its curves, each (connections,), with which it does what another does with these parameters."""
        return {}

    def stiffness_at_rest(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray | float:
        """dr_n/de of a connection at rest, N/m, which with k says how long the steps of a simulation may be."""
        return 0.0

    def damping_at_rest(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray | float:
        """dr_n/d(de) of a connection at rest, N s/m, which with c says how long the steps of a simulation may be."""
        return 0.0

    def starts(self, stiffness: float, elongation: float) -> Mapping[str, tuple[float, ...]]:
        """Kind to where an unknown parameter starts, and its order of magnitude: k's too. Others start at zero.

        A third number is what the prior is counted in, where that is less.

        Args:
            stiffness: Of a linear connection that comes near, N/m.
            elongation: Root mean square of what the connection may be stretched by, m.
        """
        return {}

    def unresolved(self, e: Array, de: Array, parameters: Mapping[str, Array]) -> Array:
        """Standard deviation of what a force may do that the law is too coarse for, N; otherwise as :meth:`force`."""
        return 0.0 * e

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


class Hysteresis(Nonlinearity):
    """A connection with memory: r = c de + k e + r_n(e, de) + z_1, whose states z (N) obey dz/dt = rate.

    The first state is a hidden force; others, which begin at zero, are in its rate alone. All are unknown functions of
    time beside the motion. The law's parameters enter the rate of the first one alone.
    """

    states: ClassVar[int] = 1
    reversal_speed: float | None = 0.0

    @abstractmethod
    def rate(self, e: Array, de: Array, states: Sequence[Array], parameters: Mapping[str, Array]) -> Sequence[Array]:
        """dz/dt of every state, each (..., connections), N/s; written as :meth:`force` is.

        Args:
            e: Elongation (..., connections), m.
            de: Its rate, m/s.
            states: Each (..., connections), N.
            parameters: Each broadcastable against e.
        """

    @abstractmethod
    def creates_energy(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray:
        """(connections,) bool: whose parameters allow a cycle that gives more energy than it takes."""

    @abstractmethod
    def stiffness_at_rest(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray | float:
        """See :meth:`Nonlinearity.stiffness_at_rest`: here dz/de, the hidden force's share."""
