"""The internal forces of connections at a trained solution, with their standard deviations.

Energy that connections dissipate over the record, with its standard deviation.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.system.connection_groups import Linearisation, slopes
from pinn_cli.system.energy import dissipated_power, stored_by_memory, trapezoids
from pinn_cli.training.covariance import ReadoutPosterior
from pinn_cli.training.minimise import Point
from pinn_cli.training.normal_equations import NormalEquations


def connection_forces(posterior: ReadoutPosterior) -> tuple[np.ndarray, np.ndarray]:
    """R = c de + k e + r_n(e, de) + z of `Structure.added` at the samples, and its deviation, each (N, C), N."""
    equations, dynamics = posterior.equations, posterior.equations.dynamics
    segments, structure, parameters = equations.observation, dynamics.structure, equations.parameters(posterior.point)
    forces, deviations = (segments.mask.new_zeros((segments.samples, len(structure.added))) for _ in range(2))
    width = 2 * segments.feature.shape[1]  # of the motions at both ends
    for part in equations.windows(segments, width):
        group, jet = segments.part(part), equations.jet(segments, posterior.point, part)
        slope = dynamics.linearise(jet, parameters)
        e, de = (structure.elongation(dynamics.stretching(x)) for x in (jet.value, jet.rate))
        force = structure.connection_force(e, de, parameters, jet.value[..., dynamics.hidden])
        group.place(force[..., torch.as_tensor(structure.added)], forces)
        std = torch.stack([_deviation(posterior, group, slope, c) for c in structure.added.tolist()], -1)
        coarse = structure.unresolved_force(e, de, parameters)[..., torch.as_tensor(structure.added)]
        group.place(torch.hypot(std, coarse), deviations)
    return forces.numpy(), deviations.numpy()


def _deviation(posterior: ReadoutPosterior, segments: Segments, slope: Linearisation, connection: int) -> Tensor:
    """(I, S), by the linear terms that a connection's force consists of."""
    equations = posterior.equations
    dynamics = equations.dynamics
    local = torch.as_tensor(equations.layout.columns(segments.feature, coupled=False))
    value, rate, _ = segments.orders
    stretch = dynamics.stretched[connection]
    stiffness, damping = (x[..., connection, None] for x in (slope.stiffness, slope.damping))
    rows = [float(weight) * (stiffness * value + damping * rate) for weight in stretch.data]
    functions = stretch.indices.tolist()
    hidden = int(dynamics.structure.hidden_force[connection])
    if hidden >= 0:
        functions.append(dynamics.hidden.start + hidden)
        rows.append(value)
    position = torch.cat([local[:, function] for function in functions], -1)
    held = _by_parameter(posterior, slope, connection)
    return posterior.deviation(position, torch.cat(rows, -1), held)


def _by_parameter(posterior: ReadoutPosterior, slope: Linearisation, connection: int) -> Tensor:
    """(I, S, p), the force by each uncertain parameter, per prior standard deviation; by its own, not by its memory."""
    equations = posterior.equations
    structure, uncertain = equations.dynamics.structure, equations.uncertain
    held = torch.zeros((*slope.stiffness.shape[:2], len(uncertain)), dtype=slope.stiffness.dtype)
    for i, (parameter, scale) in enumerate(zip(uncertain, equations.scale.tolist(), strict=True)):
        members = structure.members.get(parameter.kind, np.array([], dtype=np.int64))
        acts = parameter.kind in slope.by_parameter and members[parameter.index] == connection
        branch = equations.dynamics.branch(parameter.kind)[parameter.index] if acts else -1
        if branch == connection:
            held[..., i] = scale * slope.by_parameter[parameter.kind][..., parameter.index]
    return held


def dissipated_energy(posterior: ReadoutPosterior) -> tuple[np.ndarray, np.ndarray]:
    """Of `Structure.added` over the whole record, J, and its standard deviation, each (C,).

    An integral over the record takes all of the motion and all parameters at once, so its deviation needs the whole
    inverse and not its band: one solution of the band for every connection.
    """
    equations, segments = posterior.equations, posterior.equations.observation
    connections = equations.dynamics.structure.added
    energy, by_weight = np.zeros(len(connections)), np.zeros((equations.layout.size, len(connections)))
    by_kind: dict[str, Tensor] = {}
    for part in equations.windows(segments):
        dissipated, by_motion, by_member = _dissipated(equations, posterior.point, part)
        energy += dissipated.numpy()
        _add_by_weight(by_weight, by_motion, equations, part)
        for kind, slope in by_member.items():
            by_kind[kind] = by_kind[kind] + slope if kind in by_kind else slope
    return energy, posterior.factor.deviations(by_weight, _gradient_of_parameters(equations, by_kind))


def _gradient_of_parameters(equations: NormalEquations, by_kind: dict[str, Tensor]) -> np.ndarray:
    """(p, C), J per prior standard deviation, from the slopes of every kind's members: each has one connection."""
    structure, scale = equations.dynamics.structure, equations.scale.numpy()
    out = np.zeros((len(equations.uncertain), len(structure.added)))
    for row, parameter in enumerate(equations.uncertain):
        if parameter.kind in by_kind:
            connection = structure.added == structure.members[parameter.kind][parameter.index]
            out[row, connection] = scale[row] * float(by_kind[parameter.kind][parameter.index])
    return out


def _dissipated(
    equations: NormalEquations, point: Point, part: slice
) -> tuple[Tensor, tuple[Tensor, Tensor, Tensor], dict[str, Tensor]]:
    """What connections dissipate in some groups of samples, and how it changes.

    Every connection has its own power, so one reverse pass through their sum gives every derivative.

    Returns:
        (C,), J; its derivatives by elongations and their rates, each (I, S, C), and by hidden forces (I, S, h); kind
        of parameter to those by every member, (members,).
    """
    dynamics, structure = equations.dynamics, equations.dynamics.structure
    segments, jet = equations.observation.part(part), equations.jet(equations.observation, point, part)
    e, de = (structure.elongation(dynamics.stretching(x)) for x in jet[:2])
    parameters, time = equations.parameters(point), equations.problem.record.time
    weight, ends = trapezoids(time), np.zeros(len(time))
    ends[0], ends[-1] = 1.0, -1.0

    def energy(e: Tensor, de: Tensor, z: Tensor, *values: Tensor) -> Tensor:
        all_parameters = {**parameters, **dict(zip(structure.carriers, values, strict=True))}
        power = dissipated_power(structure, e, de, all_parameters, z)
        stored = stored_by_memory(structure, z, all_parameters)
        dissipated, released = (
            (segments.gather(torch.as_tensor(x).to(e))[..., None] * of_time).sum((0, 1))
            for x, of_time in ((weight, power), (ends, stored))
        )
        dissipated = dissipated.index_add(0, torch.as_tensor(structure.memory), released)
        return dissipated[torch.as_tensor(structure.added)]

    z, given = jet.value[..., dynamics.hidden], (parameters[kind] for kind in structure.carriers)
    dissipated, (by_e, by_de, by_z, *by) = slopes(energy, e, de, z, *given)
    return dissipated, (by_e, by_de, by_z), dict(zip(structure.carriers, by, strict=True))


def _add_by_weight(
    out: np.ndarray, by_motion: tuple[Tensor, Tensor, Tensor], equations: NormalEquations, part: slice
) -> None:
    """Add the derivatives (size, C) by the readout weights that are alive in some groups, from :func:`_dissipated`."""
    dynamics, structure = equations.dynamics, equations.dynamics.structure
    segments, (by_value, by_rate, by_hidden) = equations.observation.part(part), by_motion
    local = equations.layout.columns(segments.feature, coupled=False)  # (I, functions, B)
    moment = (segments.orders[0].mT @ by_value + segments.orders[1].mT @ by_rate).numpy()
    for column, connection in enumerate(structure.added.tolist()):
        stretch = dynamics.stretched[connection]
        for function, weight in zip(stretch.indices.tolist(), stretch.data.tolist(), strict=True):
            np.add.at(out[:, column], local[:, function], weight * moment[..., connection])
    hidden = (segments.orders[0].mT @ by_hidden).numpy()
    for number, connection in enumerate(structure.memory.tolist()):
        column = int(np.searchsorted(structure.added, connection))
        np.add.at(out[:, column], local[:, dynamics.hidden.start + number], hidden[..., number])
