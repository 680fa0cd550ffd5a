"""Loss weights that are noise levels, read off the record: lambda = 1 / sigma^2."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from pinn_cli.network.base import Network
from pinn_cli.network.spline import Spline
from pinn_cli.record.record import RESPONSE_QUANTITIES
from pinn_cli.record.spectrum import record_band
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.gradient.learned_parameters import LearnedParameters
from pinn_cli.training.gradient.loss_weights import LossWeights, Weights
from pinn_cli.training.gradient.losses import Losses
from pinn_cli.training.noise_model import sensor_noise

# Of the force that acts, its root mean square: what the model is taken to leave out before anything is known, and at
# least: a network is not asked to follow the equations of motion more closely than that.
FIRST_DISCREPANCY, LEAST_DISCREPANCY = 0.01, 1e-3


class EvidenceWeights(Weights):
    """The weighted loss is a negative log-likelihood, but for a factor that makes the observations' weight 1.

    Sensors have the white noise that a spline over the record's band cannot follow. What the model leaves out is a
    force on every DOF, with 2 T f independent values per DOF in a record of duration T and band f. Its level begins at
    a hundredth of the force: at a tenth, networks linger where soft physics lets them. Where a later stage begins it is
    MacKay's ||r||^2 / (N - gamma) of the equations of motion without a measured force. A gradient method has no
    Hessian, so gamma, the values that the network has used up, is guessed: as many per DOF as the record can hold,
    shared alike by all observations and equations. Continuity weighs as much as the equations of motion do, and
    ``physics_growth`` has no part.

    Attributes:
        discrepancy: Standard deviation of the force that the model leaves out, over the scale of the physics residual.
    """

    def __init__(self) -> None:
        self.found = LossWeights().by_term(1.0)
        self.observation, self.force, self.independent = 1.0, 0.0, 1.0
        self.force_rms, self.discrepancy = 1.0, 0.0

    def prepare(self, problem: Problem, scales: Mapping[str, float], points: int) -> None:
        """Read the noise of the sensors off the record.

        Args:
            problem: Its record.
            scales: Of the residuals, by quantity.
            points: Collocation points.
        """
        record = problem.record
        response, force = sensor_noise(Spline().build(record), record)
        variances = [
            np.square(level[np.isfinite(level)] / scales[quantity])
            for quantity, level in zip(RESPONSE_QUANTITIES, response.values(), strict=True)
        ]
        self.observation = float(np.concatenate(variances).mean())
        measured = force[np.isfinite(force)]
        self.force = float(np.mean(np.square(measured / scales["force"]))) if len(measured) else 0.0
        acting = record.force[:, record.sensors("force")]
        rms = float(np.sqrt(np.mean(np.square(acting)))) if acting.size else scales["force"]
        self.independent = min(1.0, 2.0 * record_band(record) * record.duration / points)
        self.force_rms = rms / scales["force"]
        self.discrepancy = FIRST_DISCREPANCY * self.force_rms
        self._weigh()

    def begin_stage(self, losses: Losses, network: Network, parameters: LearnedParameters, stage: int) -> None:
        """See :meth:`Weights.begin_stage`."""
        if stage == 0:
            self.prepare(losses.problem, losses.scales, len(losses.target.physics_time))
            return
        with torch.no_grad():
            terms = losses.terms(network, parameters)
        target = losses.target
        equations, sensors = int(target.equation.sum()), sum(int(mask.sum()) for mask in target.sensors.values())
        left = max(1.0 - len(target.equation) / (equations + sensors), 1.0 / (equations + sensors))
        name = "unforced" if bool(target.unforced.any()) else "forced"
        dofs = int((target.unforced if name == "unforced" else target.equation).sum())
        mean_square = float(terms[name]) / max(dofs, 1)
        self.discrepancy = max(math.sqrt(mean_square / left), LEAST_DISCREPANCY * self.force_rms)
        self._weigh()

    def _weigh(self) -> None:
        # Values that are not independent of each other must not count as if they were.
        discrepancy = self.discrepancy**2 / self.independent
        self.found["unforced"] = self.found["continuity"] = self.observation / discrepancy
        self.found["forced"] = self.observation / (self.force + discrepancy)
        self.found["observation"], self.found["prior"] = 1.0, self.observation

    def by_term(self, physics_factor: float) -> dict[str, float]:
        """See :meth:`Weights.by_term`."""
        return dict(self.found)

    def state_dict(self) -> dict[str, Any]:
        """See :meth:`Weights.state_dict`."""
        names = ("observation", "force", "independent", "force_rms", "discrepancy")
        return {"found": dict(self.found), **{name: getattr(self, name) for name in names}}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """See :meth:`Weights.load_state_dict`."""
        for name, value in state.items():
            setattr(self, name, dict(value) if name == "found" else value)
