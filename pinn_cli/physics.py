"""Observation, continuity and physics residuals of (network, chain, record): the paper's eqs. 8 to 10, written once.

Where the force between samples is held (``intersample: zero_order_hold``), the structure answers to f(t - dt/2) while
samples are taken at t. :class:`Targets` puts that in one place: physics is enforced at t_k + dt/2 with the force sample
f_k, and the jump that a held force puts into the acceleration of its own DOF, (f_k - f_{k-1}) / 2m, is taken out of the
measured accelerations, so that everything else sees a smooth motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from pinn_cli.network.network import States
from pinn_cli.record.between_samples import refined, refined_times
from pinn_cli.record.record import Record
from pinn_cli.record.response import RESPONSE_QUANTITIES, Response
from pinn_cli.system.dynamics import Dynamics
from pinn_cli.system.functions import Jet


@dataclass(frozen=True, eq=False)
class Targets:
    """What the residuals compare with, as tensors on one device.

    Attributes:
        observation_time: (N,), s, when the response sensors were read.
        physics_time: (N,), s, the collocation points that belong to the force samples.
        response: Quantity to (..., channels), 0 where there is no sensor; n channels, one of the ground.
        sensors: Quantity to (channels,) bool.
        force: (N, functions) measured force; 0 where known to be zero or unknown, and of what is no motion.
        observer_force: (N, n), the force that belongs to the response samples: where it is held, the mean of before and
            after.
        measured_force, unforced: (functions,) bool; the equations of those in neither are not enforced: of DOFs that
            carry any force whatever.
        force_between: (P, n), N, standard deviation of what the samples leave open about the force at collocation
            points between them; None where every point is a sample.
        points_per_sample: Collocation points for every force sample.
    """

    observation_time: Tensor
    physics_time: Tensor
    response: dict[str, Tensor]
    sensors: dict[str, Tensor]
    force: Tensor
    observer_force: Tensor
    measured_force: Tensor
    unforced: Tensor
    force_between: Tensor | None = None
    points_per_sample: int = 1

    @property
    def equation(self) -> Tensor:
        """(functions,) bool: those whose equation is enforced."""
        return self.measured_force | self.unforced

    def at(self, samples: Tensor) -> Targets:
        """The same at some of the samples, given by their indices (P,)."""
        return replace(
            self,
            observation_time=self.observation_time[samples],
            physics_time=self.physics_time[samples],
            response={quantity: values[samples] for quantity, values in self.response.items()},
            force=self.force[samples],
            observer_force=self.observer_force[samples],
        )


def hold_delay(record: Record) -> float:
    """How much later the structure feels a force sample than it was taken, s."""
    return record.step / 2.0 if record.intersample == "zero_order_hold" else 0.0


def targets(
    record: Record, dynamics: Dynamics, device: str = "cpu", dtype: torch.dtype = torch.float64, refinement: int = 1
) -> Targets:
    """The record as the residuals need it; several collocation points for every sample need a band-limited force."""

    def tensor(values: np.ndarray) -> Tensor:
        return torch.as_tensor(values, device=device, dtype=torch.bool if values.dtype == bool else dtype)

    response = {quantity: np.nan_to_num(record.histories(quantity)) for quantity in dynamics.observed}
    measured, force = record.sensors("force"), np.nan_to_num(record.force)
    if dynamics.structure.is_modal or dynamics.inputs.loads:  # functions, with sensors of their own
        measured, force = np.zeros(dynamics.ndof, bool), np.zeros((len(record.time), dynamics.ndof))
    jump = np.zeros_like(force)
    if record.intersample == "zero_order_hold":
        jump = np.diff(force, axis=0, prepend=2 * force[:1] - force[1:2])
        mass = dynamics.structure.parameters["m"].detach().cpu().numpy()
        response["acceleration"] = response["acceleration"] - jump / (2.0 * mass)
    points, between = force, None
    if refinement > 1:
        points, between = refined(force, refinement)
    return Targets(
        tensor(record.time),
        tensor(refined_times(record.time, refinement) + hold_delay(record)),
        {quantity: tensor(values) for quantity, values in response.items()},
        {quantity: tensor(record.plain(quantity)) for quantity in response},
        dynamics.padded(tensor(points)),
        dynamics.padded(tensor(force - jump / 2.0)),
        dynamics.padded(tensor(measured)),
        _known_rest(record, dynamics).to(device),
        None if between is None else dynamics.padded(tensor(between)),
        refinement,
    )


def _known_rest(record: Record, dynamics: Dynamics) -> Tensor:
    """(functions,) bool: those on whose equation no force acts that was measured, and none that is left open."""
    known = np.ones(dynamics.size, dtype=bool)
    if not dynamics.structure.is_modal:
        known[: dynamics.ndof] = record.unforced
        known[dynamics.loaded] = True
    known[dynamics.filters] = False
    return torch.as_tensor(known)


def observation_masks(target: Targets, through: str) -> dict[str, Tensor]:
    """Which DOFs (n,) each observation residual has, by name; names without any are left out.

    Accelerations are compared ``through`` the network's ``derivative``, the ``observer`` equation (f* - restoring
    force) / m (paper, eq. 8), or ``both``. The observer needs the force: a DOF whose force is unknown is compared
    through the derivative.
    """
    masks = dict(target.sensors)
    if through != "derivative":
        accelerometers = target.sensors["acceleration"]
        masks["observer"] = accelerometers & target.equation[: len(accelerometers)]
        if through == "observer":
            masks["acceleration"] = accelerometers & ~masks["observer"]
    return {name: mask for name, mask in masks.items() if bool(mask.any())}


def observation_residuals(
    states: States, target: Targets, dynamics: Dynamics, parameters: Mapping[str, Tensor], through: str
) -> dict[str, Tensor]:
    """Estimated minus measured response by name, each (..., channels), 0 where there is no sensor (paper, eq. 10a)."""
    jet = Jet(*states[:3])
    estimated = {quantity: dynamics.sensed(quantity, jet) for quantity in target.sensors}
    measured = {**target.response, "observer": target.response["acceleration"]}
    masks = observation_masks(target, through)
    if "observer" in masks:
        estimated["observer"] = dynamics.structure.acceleration(
            states.displacement, states.velocity, target.observer_force, parameters
        )
    return {name: (estimated[name] - measured[name]) * mask for name, mask in masks.items()}


def physics_residual(states: States, target: Targets, dynamics: Dynamics, parameters: Mapping[str, Tensor]) -> Tensor:
    """Force that the motion takes minus the force that acts, (..., functions), 0 where unknown (paper, eq. 10c)."""
    return (dynamics.residual(Jet(*states[:3]), parameters) - target.force) * target.equation


def estimated_response(
    record: Record, dynamics: Dynamics, parameters: Mapping[str, Tensor], at_observation: States, at_physics: States
) -> Response:
    """Estimated motion and force at the record's own samples, in SI units; forces belong to their force samples.

    Where the force is held between samples, the acceleration of a forced DOF jumps at every sample; the sample holds
    the value after the jump: the smooth acceleration plus half the jump of the estimated force over the mass. This is
    the inverse of what :func:`targets` does to the measured accelerations. The functions, each (N, functions), are at
    :attr:`Targets.observation_time` and at :attr:`Targets.physics_time` of every sample.
    """

    def array(x: Tensor) -> np.ndarray:
        return x.detach().cpu().double().numpy()

    felt, seen = Jet(*at_physics[:3]), Jet(*at_observation[:3])
    force = dynamics.external_force(felt, parameters)
    displacement, velocity, acceleration = (dynamics.sensed(quantity, seen) for quantity in RESPONSE_QUANTITIES)
    if hold_delay(record):
        forced = torch.as_tensor(record.sensors("force"), device=force.device)
        before_and_after = dynamics.external_force(seen, parameters)
        acceleration = acceleration + (force - before_and_after) / parameters["m"] * forced
    ground, hidden = array(seen.value[..., dynamics.ground]), array(seen.value[..., dynamics.hidden])
    supports = array(torch.stack([x[..., dynamics.supports] for x in seen], 1))
    # Where they are not the DOFs: displacement and velocity (N, 2, n).
    coordinates = array(torch.stack((seen.value, seen.rate), 1)[..., : dynamics.ndof])
    return Response(
        record.time,
        array(displacement),
        array(velocity),
        array(acceleration),
        array(force),
        ground[:, 0] if ground.size else None,
        hidden if hidden.size else None,
        coordinates if dynamics.structure.is_modal else None,
        supports if dynamics.inputs.supports else None,
        array(dynamics.connection_force(seen, parameters)),
    )
