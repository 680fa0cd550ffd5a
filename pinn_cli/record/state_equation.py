"""A structure's equation of motion as a first-order one: its state and the slope of that state."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.system.parameters import MASS

if TYPE_CHECKING:
    import numpy.typing as npt

    from pinn_cli.record.runge_kutta_step import Slope
    from pinn_cli.system.structure import Structure


@dataclass(frozen=True, eq=False)
class StateEquation:
    """Of a structure under a load: the force (n,), or, where ground or supports move, force and what moves (2, n + S).

    The first row of that holds the force and behind it the displacement of the supports, the second row the ground's
    acceleration beside every coordinate and the velocity of the supports. All of it is in the structure's coordinates.

    Its state is {u, v}, (2, n); with hidden forces z it is {u, v, z} in a row, (2 n + h,).

    Attributes:
        structure: Whose parameters are detached.
        shaken: Whether its ground or a support moves.
    """

    structure: Structure
    shaken: bool

    @cached_property
    def _parameters(self) -> dict[str, np.ndarray]:
        return self.structure.parameters_like(np.empty(0))

    def start(self, initial: npt.ArrayLike | None) -> np.ndarray:
        """The state at the first time, from displacement, velocity and hidden forces; rest where None.

        Raises:
            ValueError: It has another shape, or is not finite.
        """
        n, hidden = self.structure.coordinates, len(self.structure.memory)
        if initial is None:
            return np.zeros(2 * n + hidden) if hidden else np.zeros((2, n))
        parts = [np.array(part, dtype=np.float64) for part in initial]  # type: ignore[union-attr]
        sizes = [part.shape for part in parts]
        if sizes not in ([(n,), (n,), (hidden,)], [(n,), (n,)]) or not all(np.isfinite(part).all() for part in parts):
            also = f", and ({hidden},) hidden forces" if hidden else ""
            raise ValueError(f"the initial state must be {{displacement, velocity}}, (2, {n}) finite numbers{also}")
        if not hidden:
            return np.array(parts[:2])
        return np.concatenate((*parts, np.zeros(2 * n + hidden - sum(map(len, parts)))))

    @cached_property
    def slope(self) -> Slope:
        """From a state and a load to d(state)/dt."""
        structure = self.structure
        products = structure.incidence.products()
        if self.shaken or products is None or len(structure.groups) > 1 or len(structure.memory):
            return self._slope
        (group,), parameters, (elongation, pull) = structure.groups, self._parameters, products

        # The same operations as `Structure.acceleration` in the same order, to the same bits: a simulation takes them
        # ten thousand times, and half of its time was finding out again which they are.
        def slope(state: np.ndarray, load: np.ndarray) -> np.ndarray:
            found = np.empty_like(state)
            found[0] = velocity = state[1]
            force = group.force(state[0].dot(elongation), velocity.dot(elongation), parameters)
            np.divide(load - force.dot(pull), parameters[MASS], out=found[1])
            return found

        return slope

    def _slope(self, state: np.ndarray, load: np.ndarray) -> np.ndarray:
        structure, p = self.structure, self._parameters
        n, hidden = structure.coordinates, len(structure.memory)
        u, v, z = (state[:n], state[n : 2 * n], state[2 * n :]) if hidden else (*state, None)
        x, dx = (np.concatenate(pair) for pair in ((u, load[0, n:]), (v, load[1, n:]))) if self.shaken else (u, v)
        acceleration = structure.acceleration(x, dx, load[0, :n] if self.shaken else load, p, z)
        if self.shaken:
            acceleration = acceleration - structure.with_ground * load[1, :n]
        if z is None:
            return np.array((v, acceleration))
        rate = structure.hidden_rate(structure.elongation(x), structure.elongation(dx), z, p)
        return np.concatenate((v, acceleration, rate))

    def split(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Displacement and velocity (N, n), and hidden forces (N, h) where there are any, of states (N, ...)."""
        n = self.structure.coordinates
        if len(self.structure.memory):
            return states[:, :n], states[:, n : 2 * n], states[:, 2 * n :]
        return states[:, 0], states[:, 1], None
