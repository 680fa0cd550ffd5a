"""Energy that connections dissipate over the record, with its standard deviation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from pinn_cli.system.energy import dissipated_power, stored_by_memory, trapezoids
from pinn_cli.training.band.normal_equations import NormalEquations
from pinn_cli.training.band.point import Point
from pinn_cli.training.band.posterior import ReadoutPosterior


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
    by_hidden: Tensor | None
    by_kind: dict[str, Tensor]

    @classmethod
    def of(cls, equations: NormalEquations, point: Point, part: slice) -> _Energy:
        """Every connection has its own power, so one reverse pass through their sum gives every derivative."""
        dynamics, structure = equations.dynamics, equations.dynamics.structure
        segments, jet = equations.observation.part(part), equations.jet(equations.observation, point, part)
        e, de = (structure.elongation(dynamics.stretching(x)).detach().requires_grad_() for x in jet[:2])
        z = jet.value[..., dynamics.hidden].detach().requires_grad_() if len(structure.memory) else None
        given = {k: v.detach().clone().requires_grad_() for k, v in equations.parameters(point).items()}
        inner = {kind: given[kind] for kind in structure.carriers}
        time = equations.problem.record.time
        weight, ends = trapezoids(time), np.zeros(len(time))
        ends[0], ends[-1] = 1.0, -1.0
        with torch.enable_grad():
            power = dissipated_power(structure, e, de, given, z)
            each = (segments.gather(torch.as_tensor(weight).to(e))[..., None] * power).sum((0, 1))
            if z is not None:
                stored = stored_by_memory(structure, z, given)
                released = (segments.gather(torch.as_tensor(ends).to(e))[..., None] * stored).sum((0, 1))
                each = each.index_add(0, torch.as_tensor(structure.memory, device=e.device), released)
            each = each[torch.as_tensor(structure.added, device=e.device)]
            leaves = [e, de, *([] if z is None else [z]), *inner.values()]
            slopes = torch.autograd.grad(each.sum(), leaves, allow_unused=True)
        filled = [torch.zeros_like(x) if slope is None else slope for x, slope in zip(leaves, slopes, strict=True)]
        motion, rest = filled[: 2 if z is None else 3], filled[2 if z is None else 3 :]
        by_kind = dict(zip(inner, rest, strict=True))
        return cls(each.detach(), motion[0], motion[1], None if z is None else motion[2], by_kind)

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
        if self.by_hidden is None:
            return
        hidden = (segments.displacement.mT @ self.by_hidden).cpu().numpy()
        for number, connection in enumerate(structure.memory.tolist()):
            column = int(np.searchsorted(structure.added, connection))
            np.add.at(out[:, column], local[:, dynamics.hidden.start + number], hidden[..., number])
