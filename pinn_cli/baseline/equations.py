"""All equations of a structure and its inputs as differential equations of first order, with their derivatives.

The state is x = (values of all functions, rates of those whose equation is of second order). A function's own highest
derivative takes up what its equation leaves over; with M the mass in it (of a hidden force one over the record's rate),

    M highest derivative = f + e - (the equation with a highest derivative of zero).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch

from pinn_cli.record.runge_kutta import runge_kutta_step
from pinn_cli.record.steps import Slope
from pinn_cli.system.dynamics import Dynamics
from pinn_cli.system.functions import Jet
from pinn_cli.system.parameters import MASS, Parameter, ParameterVector

# Numbers of the steps' derivatives that are held at once: little enough for the caches.
DERIVATIVES_AT_ONCE = 500_000


class Equations:
    """The equations under some parameters.

    Args:
        dynamics: F functions.
        vector: The uncertain parameters, p of them; those of sensors do nothing here.
        parameters: Kind to all values.

    Attributes:
        first, second: The functions whose equation is of first order, and of second.
        size: s, of the state.
        columns: s + F + p: derivatives are by the state, by a force in each equation, N, and by the uncertain
            parameters, in prior standard deviations.
        mass: (F,), what divides the force in each equation.
    """

    def __init__(
        self, dynamics: Dynamics, vector: ParameterVector[np.ndarray], parameters: Mapping[str, np.ndarray]
    ) -> None:
        self.dynamics, self.vector = dynamics, vector
        self.parameters = {kind: torch.as_tensor(values) for kind, values in parameters.items()}
        functions = np.arange(dynamics.size)
        self.first = functions[dynamics.hidden]
        self.second = np.setdiff1d(functions, self.first)
        self.size = dynamics.size + len(self.second)
        self.columns = self.size + dynamics.size + len(vector.moving)
        self.mass = dynamics.mass(self.parameters).numpy().copy()
        self.mass[self.first] = 1.0 / dynamics.inputs.rate
        self._into, self._by = dynamics.coupling.into.toarray().T, dynamics.coupling.by.toarray()
        self._pull = self._pull_of_parameters()

    def jet(self, states: np.ndarray, force: np.ndarray) -> Jet:
        """All functions and their derivatives, each (N, F), at states (N, s) under forces (N, F), N."""
        value, rate = torch.as_tensor(states[:, : self.dynamics.size]), torch.zeros(len(states), self.dynamics.size)
        rate = rate.to(value).index_copy(1, torch.as_tensor(self.second), torch.as_tensor(states[:, len(self.mass) :]))
        residual = self.dynamics.residual(Jet(value, rate, torch.zeros_like(value)), self.parameters)
        curvature = torch.as_tensor((force - residual.numpy()) / self.mass)
        rate[:, self.first], curvature[:, self.first] = curvature[:, self.first], 0.0
        return Jet(value, rate, curvature)

    def highest(self, jet: Jet) -> np.ndarray:
        """(N, F, columns), derivatives of every function's own highest derivative."""
        linearised, functions = self.dynamics.linearise(jet, self.parameters), len(self.mass)
        out = np.zeros((*jet.value.shape, self.columns))
        by_value, by_rate = (
            (self._into * x.numpy()[:, None]) @ self._by for x in (linearised.stiffness, linearised.damping)
        )
        out[:, :, :functions], out[:, :, functions : self.size] = -by_value, -by_rate[:, :, self.second]
        out[:, range(functions), range(self.size, self.size + functions)] = 1.0
        inertia = self.dynamics.inertial_acceleration(jet).numpy()
        for column, p in enumerate(self.vector.moving, self.size + functions):
            if p.kind == MASS:
                out[:, p.index, column] = -p.prior_std * inertia[:, p.index]
            elif p in self._pull:
                carriers, pull = self._pull[p]
                out[:, :, column] = linearised.by_parameter[p.kind].numpy()[:, carriers] @ pull
        out /= self.mass[:, None]
        return out

    def derivatives(self, jet: Jet) -> np.ndarray:
        """(3, N, F, columns), of all functions, of their rates and of their second derivatives."""
        highest, functions = self.highest(jet), len(self.mass)
        out = np.zeros((3, *highest.shape))
        out[0, :, range(functions), range(functions)] = 1.0
        out[1, :, self.second, np.arange(functions, self.size)] = 1.0
        out[1][:, self.first], out[2][:, self.second] = highest[:, self.first], highest[:, self.second]
        return out

    def moved(self, states: np.ndarray, force: np.ndarray, step: float) -> np.ndarray:
        """(N, s), the states one sample, ``step`` s, later than states (N, s).

        ``force`` (2 substeps + 1, N, F), N, acts at the ends and the middle of every substep.
        """
        return flow(lambda x, f: self._slope(x, self.jet(x, f)), states, force, step)

    def tangents(self, states: np.ndarray, force: np.ndarray, step: float) -> np.ndarray:
        """(N, s, columns), derivatives of that; forces by which they are taken are held through the step."""
        out = np.empty((len(states), self.size, self.columns))
        size = max(1, DERIVATIVES_AT_ONCE // (self.size * self.columns))
        for first in range(0, len(states), size):
            part = slice(first, first + size)
            start = np.zeros((*out[part].shape[:2], 1 + self.columns))
            start[:, :, 0], start[:, :, 1 : 1 + self.size] = states[part], np.eye(self.size)
            out[part] = flow(self._slope_with_tangents, start, force[:, part], step)[:, :, 1:]
        return out

    def _slope(self, states: np.ndarray, jet: Jet) -> np.ndarray:
        out = np.empty_like(states)
        out[:, : len(self.mass)], out[:, len(self.mass) :] = jet.rate, jet.curvature[:, self.second]
        return out

    def _slope_with_tangents(self, joint: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Of states and, beside them, their derivatives: (N, s, 1 + columns)."""
        functions, out, jet = len(self.mass), np.empty_like(joint), self.jet(joint[:, :, 0], force)
        direct = self.highest(jet)
        highest = direct[:, :, : self.size] @ joint[:, :, 1:]
        highest[:, :, self.size :] += direct[:, :, self.size :]
        out[:, self.second, 1:] = joint[:, functions:, 1:]
        out[:, self.first, 1:], out[:, functions:, 1:] = highest[:, self.first], highest[:, self.second]
        out[:, :, 0] = self._slope(joint[:, :, 0], jet)
        return out

    def _pull_of_parameters(self) -> dict[Parameter, tuple[np.ndarray, np.ndarray]]:
        """Of each uncertain parameter of connections: those that have it, and what they do to all equations."""
        structure, branches, out = self.dynamics.structure, self.dynamics.branches.matrix, {}
        for p in self.vector.moving:
            if p.kind in structure.carriers:
                carriers = np.flatnonzero(structure.carriers[p.kind][1] == p.index)
                pull = branches[self.dynamics.branch(p.kind)[carriers]].toarray()
                out[p] = carriers, -p.prior_std * pull
        return out


def flow(slope: Slope, start: np.ndarray, force: np.ndarray, step: float) -> np.ndarray:
    """States one sample later, of many starts (N, ...) at once, by the classical method of Runge and Kutta.

    ``slope`` leads from states and forces (N, F) to the states' time derivative; ``force`` and ``step`` are those of
    :meth:`Equations.moved`.
    """
    substeps, state = len(force) // 2, start
    for i in range(substeps):
        state = runge_kutta_step(slope, state, force[2 * i], force[2 * i + 1], force[2 * i + 2], step / substeps)
    return state
