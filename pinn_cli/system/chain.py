"""The chain of masses: the one equation of motion that simulator, losses, smoother and sampler share."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np

from pinn_cli.system.array_namespace import Array, namespace
from pinn_cli.system.connection.linear import Linear

if TYPE_CHECKING:
    from collections.abc import Mapping

    import torch

    from pinn_cli.system.connection.base import Nonlinearity

LINEAR_PARAMETERS = {"m": "kg", "c": "N s/m", "k": "N/m"}
LINEAR_TITLES = {"m": "Mass", "c": "Damping", "k": "Stiffness"}

# Up to here a product with the matrix of differences, exact for finite numbers, takes numpy a quarter of the time of
# slices; a simulation calls it ten thousand times.
_SHORT = 64


@dataclass(frozen=True, eq=False)
class Chain:
    """Masses in a row, fixed at the first connection; connection i joins DOF i-1 to DOF i.

    With elongation e_i = u_i - u_{i-1} (u_0 = 0) and internal force r_i = c_i de_i + k_i e_i + r_n(e_i, de_i), the
    equation of motion of DOF i is m_i a_i + r_i - r_{i+1} = f_i, r_{n+1} = 0 (paper, section 2 and appendix, where the
    last off-diagonal of C and K is misprinted). Everything is O(ndof), elementwise over leading dimensions,
    differentiable in state and parameters, and takes torch tensors of any dtype and device or numpy arrays.

    In every method, states, forces and results are (..., ndof) in SI units. ``parameters=None`` means the chain's own,
    moved to the dtype and device of the state; a mapping that is given must hold every name, and its entries may be
    (ndof,) or anything that broadcasts, e.g. (time, ndof).

    Attributes:
        parameters: "m" kg, "c" N s/m, "k" N/m and those of the nonlinearity, each (ndof,).
        nonlinearity: The nonlinear part of every connection.

    Raises:
        ValueError: The names or the shapes of the parameters do not fit.
    """

    parameters: dict[str, torch.Tensor]
    nonlinearity: Nonlinearity

    def __post_init__(self) -> None:
        names = (*LINEAR_PARAMETERS, *self.nonlinearity.parameters)
        if set(self.parameters) != set(names):
            raise ValueError(f"a {self.nonlinearity.name} chain has parameters {names}, not {tuple(self.parameters)}")
        shapes = {name: tuple(value.shape) for name, value in self.parameters.items()}
        if len(set(shapes.values())) != 1 or len(shapes["m"]) != 1:
            raise ValueError(f"the parameters of a chain are each (ndof,), not {shapes}")

    @property
    def ndof(self) -> int:
        """Number of degrees of freedom."""
        return self.parameters["m"].shape[-1]

    @property
    def units(self) -> dict[str, str]:
        """Unit of each parameter, powers as ``m^3``."""
        return {**LINEAR_PARAMETERS, **self.nonlinearity.units}

    @property
    def titles(self) -> dict[str, str]:
        """What a figure calls each parameter."""
        return {**LINEAR_TITLES, **self.nonlinearity.titles}

    @staticmethod
    def elongation(x: Array) -> Array:
        """x_i - x_{i-1} along the last axis, x_0 = 0; of displacements, velocities or accelerations alike."""
        if _is_short(x):
            return x.dot(_differences(x.shape[-1], x.dtype))
        elongation: Array = namespace(x).concatenate((x[..., :1], x[..., 1:] - x[..., :-1]), -1)
        return elongation

    def connection_force(self, e: Array, de: Array, parameters: Mapping[str, Array] | None = None) -> Array:
        """Internal force r = c de + k e + r_n(e, de) of every connection, from elongation and its rate."""
        p = self.parameters_like(e) if parameters is None else parameters
        return p["c"] * de + p["k"] * e + self.nonlinearity.force(e, de, p)

    def restoring_force(self, u: Array, v: Array, parameters: Mapping[str, Array] | None = None) -> Array:
        """r_i - r_{i+1}: what the connections pull DOF i back with, from displacement and velocity."""
        r = self.connection_force(self.elongation(u), self.elongation(v), parameters)
        if _is_short(r):
            return r.dot(_differences(r.shape[-1], r.dtype).T)
        pull: Array = namespace(r).concatenate((r[..., :-1] - r[..., 1:], r[..., -1:]), -1)
        return pull

    def external_force(self, u: Array, v: Array, a: Array, parameters: Mapping[str, Array] | None = None) -> Array:
        """The force that this motion takes, m a + restoring force (the paper's physics operator, F[n:2n])."""
        p = self.parameters_like(u) if parameters is None else parameters
        return p["m"] * a + self.restoring_force(u, v, p)

    def acceleration(self, u: Array, v: Array, f: Array, parameters: Mapping[str, Array] | None = None) -> Array:
        """(f - restoring force) / m: the observer equation of an accelerometer."""
        p = self.parameters_like(u) if parameters is None else parameters
        return (f - self.restoring_force(u, v, p)) / p["m"]

    def parameters_like(self, x: Array) -> dict[str, Array]:
        """The parameters as x is: numpy arrays of its dtype, or tensors of its dtype and device with their graph."""
        if isinstance(x, np.ndarray):
            return {name: value.detach().cpu().numpy().astype(x.dtype) for name, value in self.parameters.items()}
        return {name: value.to(x) for name, value in self.parameters.items()}

    def with_parameters(self, **tensors: torch.Tensor) -> Chain:
        """The same chain with the named parameters replaced; each (ndof,)."""
        return replace(self, parameters={**self.parameters, **tensors})

    def linearised(self) -> Chain:
        """The chain without its nonlinearity: m, c, k stay, kappa or mu go (the paper's 'linear' model error)."""
        return Chain({name: self.parameters[name] for name in LINEAR_PARAMETERS}, Linear())


def _is_short(x: Array) -> TypeGuard[np.ndarray]:
    return isinstance(x, np.ndarray) and x.shape[-1] <= _SHORT


@cache
def _differences(ndof: int, dtype: np.dtype[Any]) -> np.ndarray:
    """(ndof, ndof) that makes x_i - x_{i-1}, x_0 = 0, of a row x; its transpose makes x_i - x_{i+1}, x_{n+1} = 0."""
    return np.eye(ndof, dtype=dtype) - np.eye(ndof, k=1, dtype=dtype)
