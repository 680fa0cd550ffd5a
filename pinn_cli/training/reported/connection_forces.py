"""The internal forces of connections at a trained solution, with their standard deviations."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.system.connection_groups import Linearisation
from pinn_cli.training.covariance import ReadoutPosterior


def connection_forces(posterior: ReadoutPosterior) -> tuple[np.ndarray, np.ndarray]:
    """R = c de + k e + r_n(e, de) + z of `Structure.added` at the samples, and its deviation, each (N, C), N."""
    equations = posterior.equations
    segments, connections = equations.observation, equations.dynamics.structure.added
    forces, deviations = (segments.mask.new_zeros((segments.samples, len(connections))) for _ in range(2))
    width = 2 * segments.feature.shape[1]  # of the motions at both ends
    for part in equations.windows(segments, width):
        group = segments.part(part)
        force, std = _of_groups(posterior, group, part)
        group.place(force, forces)
        group.place(std.to(deviations.device), deviations)
    return forces.cpu().numpy(), deviations.cpu().numpy()


def _of_groups(posterior: ReadoutPosterior, segments: Segments, part: slice) -> tuple[Tensor, Tensor]:
    """The forces and their deviations in some groups of the samples, each (I, S, C)."""
    equations, dynamics = posterior.equations, posterior.equations.dynamics
    jet = equations.jet(equations.observation, posterior.point, part)
    parameters = equations.parameters(posterior.point)
    slope, structure = dynamics.linearise(jet, parameters), dynamics.structure
    u, v = (dynamics.stretching(x) for x in (jet.value, jet.rate))
    z = jet.value[..., dynamics.hidden] if len(structure.memory) else None
    force = structure.connection_force(structure.elongation(u), structure.elongation(v), parameters, z)
    deviations = [_deviation(posterior, segments, slope, c) for c in structure.added.tolist()]
    return force[..., torch.as_tensor(structure.added, device=force.device)], torch.stack(deviations, -1)


def _deviation(posterior: ReadoutPosterior, segments: Segments, slope: Linearisation, connection: int) -> Tensor:
    """(I, S), by the linear terms that a connection's force consists of."""
    equations = posterior.equations
    dynamics = equations.dynamics
    local = torch.as_tensor(equations.layout.columns(segments.feature, coupled=False))
    value, rate = segments.displacement.cpu(), segments.velocity.cpu()
    stretch = dynamics.stretched[connection]
    stiffness, damping = (x[..., connection, None].cpu() for x in (slope.stiffness, slope.damping))
    rows = [float(weight) * (stiffness * value + damping * rate) for weight in stretch.data]
    functions = stretch.indices.tolist()
    if connection in dynamics.structure.memory:
        functions.append(dynamics.hidden.start + int(np.searchsorted(dynamics.structure.memory, connection)))
        rows.append(value)
    position = torch.cat([local[:, function] for function in functions], -1)
    held = _by_parameter(posterior, slope, connection)
    return posterior.deviation(position, torch.cat(rows, -1), held)


def _by_parameter(posterior: ReadoutPosterior, slope: Linearisation, connection: int) -> Tensor:
    """(I, S, p), the force by each uncertain parameter, per prior standard deviation; by its own, not by its memory."""
    equations = posterior.equations
    structure, uncertain = equations.dynamics.structure, equations.uncertain
    held = torch.zeros((*slope.stiffness.shape[:2], len(uncertain)), dtype=slope.stiffness.dtype)
    for i, (parameter, scale) in enumerate(zip(uncertain, equations.scale.cpu().tolist(), strict=True)):
        members = structure.members.get(parameter.kind, np.array([], dtype=np.int64))
        own = parameter.kind in slope.by_parameter and members[parameter.index] == connection
        branch = equations.dynamics.branch(parameter.kind)[parameter.index] if own else -1
        if branch == connection:
            held[..., i] = scale * slope.by_parameter[parameter.kind][..., parameter.index].cpu()
    return held
