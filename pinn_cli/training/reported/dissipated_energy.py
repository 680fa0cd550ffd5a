"""Energy that connections dissipate over the record, with its standard deviation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pinn_cli.system.connection_groups import slopes
from pinn_cli.system.energy import dissipated_power, stored_by_memory, trapezoids
from pinn_cli.training.covariance import ReadoutPosterior
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.point import Point


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
        own = _Energy.of(equations, posterior.point, part)
        energy += own.each.cpu().numpy()
        own.add_by_weight(by_weight, equations, part)
        for kind, slope in own.by_kind.items():
            by_kind[kind] = by_kind[kind] + slope if kind in by_kind else slope
    return energy, posterior.factor.deviations(by_weight, _by_parameter(equations, by_kind))


def _by_parameter(equations: NormalEquations, by_kind: dict[str, Tensor]) -> np.ndarray:
    """(p, C), J per prior standard deviation, from the slopes of every kind's members: each has one connection."""
    structure, scale = equations.dynamics.structure, equations.scale.cpu().numpy()
    out = np.zeros((len(equations.uncertain), len(structure.added)))
    for row, parameter in enumerate(equations.uncertain):
        if parameter.kind in by_kind:
            own = structure.added == structure.members[parameter.kind][parameter.index]
            out[row, own] = scale[row] * float(by_kind[parameter.kind][parameter.index])
    return out


@dataclass(frozen=True, eq=False)
class _Energy:
    """What connections dissipate in some groups of samples, and how it changes.

    Attributes:
        each: (C,), J.
        by_value, by_rate: (I, S, C), by their elongations and the rates of these.
        by_hidden: (I, S, h), by the hidden forces.
        by_kind: Kind of parameter to (members,), by every member.
    """

    each: Tensor
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
            own = {**parameters, **dict(zip(structure.carriers, values, strict=True))}
            power, stored = dissipated_power(structure, e, de, own, z), stored_by_memory(structure, z, own)
            each, released = (
                (segments.gather(torch.as_tensor(x).to(e))[..., None] * of_time).sum((0, 1))
                for x, of_time in ((weight, power), (ends, stored))
            )
            each = each.index_add(0, torch.as_tensor(structure.memory, device=e.device), released)
            return each[torch.as_tensor(structure.added, device=e.device)]

        z, given = jet.value[..., dynamics.hidden], (parameters[kind] for kind in structure.carriers)
        each, (by_e, by_de, by_z, *by) = slopes(energy, e, de, z, *given)
        return cls(each, by_e, by_de, by_z, dict(zip(structure.carriers, by, strict=True)))

    def add_by_weight(self, out: np.ndarray, equations: NormalEquations, part: slice) -> None:
        """Add the derivatives (size, C) by the readout weights that are alive in these groups."""
        dynamics, structure = equations.dynamics, equations.dynamics.structure
        segments = equations.observation.part(part)
        local = equations.layout.columns(segments.feature, coupled=False)  # (I, functions, B)
        moment = (segments.displacement.mT @ self.by_value + segments.velocity.mT @ self.by_rate).cpu().numpy()
        for column, connection in enumerate(structure.added.tolist()):
            stretch = dynamics.stretched[connection]
            for function, weight in zip(stretch.indices.tolist(), stretch.data.tolist(), strict=True):
                np.add.at(out[:, column], local[:, function], weight * moment[..., connection])
        hidden = (segments.displacement.mT @ self.by_hidden).cpu().numpy()
        for number, connection in enumerate(structure.memory.tolist()):
            column = int(np.searchsorted(structure.added, connection))
            np.add.at(out[:, column], local[:, dynamics.hidden.start + number], hidden[..., number])
