"""Energy that connections dissipate over the record, with its standard deviation."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pinn_cli.system.energy import dissipated_power, stored_by_memory, trapezoids
from pinn_cli.training.band.point import Point
from pinn_cli.training.band.posterior import ReadoutPosterior


def dissipated_energy(posterior: ReadoutPosterior) -> tuple[np.ndarray, np.ndarray]:
    """Of `Structure.added` over the whole record, J, and its standard deviation, each (C,).

    An integral over the record takes all of the motion and all parameters at once, so its deviation needs the whole
    inverse and not its band: one solution of the band for every connection.
    """
    point = posterior.point
    leaves = Point(*(x.detach().clone().requires_grad_() for x in (point.unknowns, point.parameters)))
    with torch.enable_grad():
        energy = _energy(posterior, leaves)
        slopes = [
            torch.autograd.grad(each, (leaves.unknowns, leaves.parameters), retain_graph=True, allow_unused=True)
            for each in energy
        ]
    by_weight = torch.stack([weight for weight, _ in slopes], -1).cpu().numpy()
    none = torch.zeros_like(leaves.parameters)
    by_parameter = torch.stack([none if x is None else x for _, x in slopes], -1).cpu().numpy()
    return energy.detach().cpu().numpy(), posterior.factor.deviations(by_weight, by_parameter)


def _energy(posterior: ReadoutPosterior, point: Point) -> Tensor:
    """(C,), J, differentiable in the point."""
    equations = posterior.equations
    segments, dynamics, structure = equations.observation, equations.dynamics, equations.dynamics.structure
    jet, parameters = equations.jet(segments, point), equations.parameters(point)
    e, de = (structure.elongation(x[..., : dynamics.ndof]) for x in (jet.value, jet.rate))
    z = jet.value[..., dynamics.hidden] if len(structure.memory) else None
    time = equations.problem.record.time
    weight = segments.gather(torch.as_tensor(trapezoids(time)).to(e))
    energy = (weight[..., None] * dissipated_power(structure, e, de, parameters, z)).sum((0, 1))
    if z is not None:
        stored = stored_by_memory(structure, segments.scatter(z)[[0, -1]], parameters)
        places = torch.as_tensor(structure.memory, device=energy.device)
        energy = energy.index_add(0, places, stored[0] - stored[1])
    return energy[torch.as_tensor(structure.added, device=energy.device)]
