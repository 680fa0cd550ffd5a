"""Sums of the small dense blocks that residual rows add to the normal matrix, group by group and DOF by DOF."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.physics import Tangent

# Numbers of the table [J | P | r] that are held at once: a whole spline of a small chain, little enough for the caches,
# and no more # than that for Fourier features.
CHUNK = 2_000_000


@dataclass(frozen=True, eq=False)
class ChainRows:
    """Rows of m a + r_i - r_{i+1}, or of r_i - r_{i+1} alone, in local terms.

    Attributes:
        stiffness, damping: Derivative by the displacement and velocity of DOFs i-1, i, i+1, each (I, S, n, 3).
        mass: (n,), derivative by the acceleration of DOF i; None without the inertia force.
        parameter: (I, S, n, kinds, 2), derivative by the parameters of connections i and i+1, per prior standard
            deviation.
    """

    stiffness: Tensor
    damping: Tensor
    mass: Tensor | None
    parameter: Tensor

    @classmethod
    def of(cls, slope: Tangent, mass: Tensor | None, acceleration: Tensor, spread: dict[str, Tensor]) -> ChainRows:
        """Rows from the connections' tangent.

        Args:
            slope: Derivatives of the internal forces, (I, S, n).
            mass: (n,) or None, see above.
            acceleration: (I, S, n), what a mass parameter multiplies: the motion's, or the observer's.
            spread: Kind of every uncertain parameter to its prior standard deviations (n,), 0 where it is held fixed.
        """
        blocks = []
        for kind, by in spread.items():
            if kind == "m":
                inertia = acceleration * by
                blocks.append(torch.stack((inertia, torch.zeros_like(inertia)), -1))
            else:
                own = slope.by_parameter[kind] * by
                blocks.append(torch.stack((own, -_next_connection(own)), -1))
        parameter = torch.stack(blocks, -2) if blocks else acceleration.new_zeros((*acceleration.shape, 0, 2))
        return cls(_tridiagonal(slope.stiffness), _tridiagonal(slope.damping), mass, parameter)

    def jacobian(self, segments: Segments, dofs: slice) -> Tensor:
        """The given DOFs' rows by the features of DOFs i-1, i, i+1 in this order, (I, dofs, S, 3 B)."""
        displacement, velocity = (phi[:, None, :, None, :] for phi in (segments.displacement, segments.velocity))
        stiffness, damping = (x[:, :, dofs].movedim(2, 1)[..., None] for x in (self.stiffness, self.damping))
        out = displacement * stiffness
        out.addcmul_(velocity, damping)
        if self.mass is not None:
            out[..., 1, :] += segments.acceleration[:, None] * self.mass[dofs, None, None]
        return out.flatten(3)


class Blocks:
    """The sums, per group and DOF: [J | P | r]^T W [J | P | r], but for r^T W r.

    Args:
        groups, features: I and B of the network's segments.
        ndof: Number of DOFs.
        kinds: Number of kinds of uncertain parameters.
        like: A tensor of the dtype and device wanted.

    Attributes:
        columns: 3 B, local readout weights of a row.
        readout: (I, n, 3 B, 3 B + 2 kinds + 1).
        parameters: (n, 2 kinds, 2 kinds + 1).
    """

    def __init__(self, groups: int, features: int, ndof: int, kinds: int, like: Tensor) -> None:
        self.features, self.columns = features, 3 * features
        width = self.columns + 2 * kinds + 1
        self.readout = like.new_zeros((groups, ndof, self.columns, width))
        self.parameters = like.new_zeros((ndof, 2 * kinds, 2 * kinds + 1))

    def add_chain_rows(self, segments: Segments, rows: ChainRows, residual: Tensor, weight: Tensor) -> None:
        """Add rows that touch three DOFs and the parameters; residual (I, S, n), weight (n,)."""
        groups, samples, _ = segments.displacement.shape
        chunk = max(1, CHUNK // (groups * samples * self.readout.shape[-1]))
        for first in range(0, residual.shape[-1], chunk):
            dofs = slice(first, min(first + chunk, residual.shape[-1]))
            parts = (
                rows.jacobian(segments, dofs),
                rows.parameter[:, :, dofs].movedim(2, 1).flatten(3),
                residual[:, :, dofs].movedim(2, 1)[..., None],
            )
            table = torch.cat(parts, -1)
            table *= segments.mask[:, None, :, None]
            weighted = table[..., :-1] * weight[dofs][None, :, None, None]
            self.readout[:, dofs] += weighted[..., : self.columns].mT @ table
            by_parameter = table[..., self.columns :].movedim(1, 0).flatten(1, 2)
            self.parameters[dofs] += weighted[..., self.columns :].movedim(1, 0).flatten(1, 2).mT @ by_parameter

    def add_own_rows(self, features: Tensor, gram: Tensor, residual: Tensor, weight: Tensor) -> None:
        """Add rows that touch their own DOF, with features (I, S, B) and their gram (I, B, B); weight (n,)."""
        own = slice(self.features, 2 * self.features)
        self.readout[:, :, own, own] += gram[:, None] * weight[None, :, None, None]
        self.readout[:, :, own, -1] += ((features.mT @ residual) * weight).mT


def _next_connection(x: Tensor) -> Tensor:
    """Value of connection i+1 in the place of connection i, 0 at the end of the chain."""
    return torch.cat((x[..., 1:], torch.zeros_like(x[..., :1])), -1)


def _tridiagonal(x: Tensor) -> Tensor:
    """Derivative of r_i - r_{i+1} by the motion of DOFs i-1, i, i+1, from dr_i/de_i, (..., n) to (..., n, 3)."""
    after = _next_connection(x)
    return torch.stack((-x, x + after, -after), -1)
