"""The internal forces of connections at a trained solution, with their standard deviations.

Energy that connections dissipate over the record, with its standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass

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
    equations = posterior.equations
    segments, connections = equations.observation, equations.dynamics.structure.added
    forces, deviations = (segments.mask.new_zeros((segments.samples, len(connections))) for _ in range(2))
    width = 2 * segments.feature.shape[1]  # of the motions at both ends
    for part in equations.windows(segments, width):
        group = segments.part(part)
        force, std = _of_groups(posterior, group, part)
        group.place(force, forces)
        group.place(std, deviations)
    return forces.numpy(), deviations.numpy()


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
    return force[..., torch.as_tensor(structure.added)], torch.stack(deviations, -1)


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
        part_energy = _Energy.of(equations, posterior.point, part)
        energy += part_energy.dissipated.numpy()
        part_energy.add_by_weight(by_weight, equations, part)
        for kind, slope in part_energy.by_kind.items():
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


@dataclass(frozen=True, eq=False)
class _Energy:
    """What connections dissipate in some groups of samples, and how it changes.

    Attributes:
        dissipated: (C,), J.
        by_value, by_rate: (I, S, C), by their elongations and the rates of these.
        by_hidden: (I, S, h), by the hidden forces.
        by_kind: Kind of parameter to (members,), by every member.
    """

    dissipated: Tensor
    by_value: Tensor
    by_rate: Tensor
    by_hidden: Tensor
    by_kind: dict[str, Tensor]

    @classmethod
    def of(cls, equations: NormalEquations, point: Point, part: slice) -> _Energy:
        """Every connection has its own power, so one reverse pass through their sum gives every derivative."""
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
        return cls(dissipated, by_e, by_de, by_z, dict(zip(structure.carriers, by, strict=True)))

    def add_by_weight(self, out: np.ndarray, equations: NormalEquations, part: slice) -> None:
        """Add the derivatives (size, C) by the readout weights that are alive in these groups."""
        dynamics, structure = equations.dynamics, equations.dynamics.structure
        segments = equations.observation.part(part)
        local = equations.layout.columns(segments.feature, coupled=False)  # (I, functions, B)
        moment = (segments.orders[0].mT @ self.by_value + segments.orders[1].mT @ self.by_rate).numpy()
        for column, connection in enumerate(structure.added.tolist()):
            stretch = dynamics.stretched[connection]
            for function, weight in zip(stretch.indices.tolist(), stretch.data.tolist(), strict=True):
                np.add.at(out[:, column], local[:, function], weight * moment[..., connection])
        hidden = (segments.orders[0].mT @ self.by_hidden).numpy()
        for number, connection in enumerate(structure.memory.tolist()):
            column = int(np.searchsorted(structure.added, connection))
            np.add.at(out[:, column], local[:, dynamics.hidden.start + number], hidden[..., number])
