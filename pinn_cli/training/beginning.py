"""Where a motion begins that goes on from an earlier record's end: a state of which much is known already.

Displacements, velocities and hidden forces at the first sample are uncertain numbers beside the parameters, and their
prior is the joint Gaussian of both. The motion is tied to them tightly. As numbers in the border of the normal matrix
they may all be correlated, whatever its band.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pinn_cli.model.knowledge import EndState, ParameterKnowledge
from pinn_cli.record.channels import FINEST_KNOWN
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.quantities import INITIAL_STATE

# Standard deviation of the motion about its first state, over that of the state: it adds a thousandth to its variance.
TIE = 0.03
# Added to the joint correlation's diagonal: parameters and states may be correlated but for rounding.
CORRELATION_JITTER = 1e-10


@dataclass(frozen=True, eq=False)
class Beginning:
    """The uncertain numbers of a problem that begins at a known state, F of them beside p parameters.

    Attributes:
        uncertain: (p + F,), the problem's parameters, then the displacements, velocities and hidden forces.
        prescribed: Their kind to the most probable values (F,).
        std: (F,), prior standard deviations.
        precision: (p + F, p + F), of the joint prior, in prior standard deviations.
    """

    uncertain: tuple[Parameter, ...]
    prescribed: dict[str, Tensor]
    std: np.ndarray
    precision: np.ndarray

    @classmethod
    def of(cls, problem: Problem) -> Beginning | None:
        """That of a problem; None where it does not go on from an earlier record."""
        state, prior = problem.initial_state, problem.prior
        if state is None:
            return None
        if prior is None:
            raise ValueError("a motion that goes on from an earlier record has the parameters' prior from it as well")
        variance = np.maximum(np.diag(state.covariance), FINEST_KNOWN**2 * _size(state, problem) ** 2)
        std = np.sqrt(variance)
        states = tuple(
            Parameter(INITIAL_STATE, i, prescribed=float(mean), prior_std=float(s))
            for i, (mean, s) in enumerate(zip(state.mean, std, strict=True))
        )
        correlation = _joint(problem, prior, state, std)
        prescribed = {INITIAL_STATE: torch.as_tensor(state.mean)}
        return cls((*problem.uncertain, *states), prescribed, std, np.linalg.inv(correlation))

    def of_functions(self, motions: int, hidden: slice, functions: int) -> np.ndarray:
        """(functions, 2), which of F numbers is the value of each function, and which its rate; -1 where none is.

        The first functions are motions; others are hidden forces.
        """
        out = np.full((functions, 2), -1)
        out[:motions] = np.arange(2 * motions).reshape(2, motions).T
        out[hidden, 0] = 2 * motions + np.arange(len(self.std) - 2 * motions)
        return out


def _size(state: EndState, problem: Problem) -> np.ndarray:
    """(F,), root mean square of the displacements, of the velocities and of the hidden forces, of each its own."""
    n = problem.dynamics.ndof
    out = np.zeros(len(state.mean))
    for part in (slice(0, n), slice(n, 2 * n), slice(2 * n, None)):
        if len(out[part]):
            out[part] = np.sqrt(np.mean(state.mean[part] ** 2 + np.diag(state.covariance)[part]))
    return out


def _joint(problem: Problem, prior: ParameterKnowledge, state: EndState, std: np.ndarray) -> np.ndarray:
    """(p + F, p + F), the correlation of parameters and state; sensors have nothing to do with a state."""
    p, count = len(problem.uncertain), state.with_parameters.shape[1]
    unit = np.array([parameter.prior_std for parameter in problem.uncertain])
    out = np.eye(p + len(std))
    out[:p, :p] = prior.correlation
    out[p:, p:] = state.covariance / np.outer(std, std)
    out[p:, :count] = state.with_parameters / np.outer(std, unit[:count])
    out[:count, p:] = out[p:, :count].T
    out[np.diag_indices_from(out)] = 1.0 + CORRELATION_JITTER
    return out
