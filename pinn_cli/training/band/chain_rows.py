"""The linearised equation of motion of a chain, row by row in local terms."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.physics import Tangent

# Numbers of the table [J | P | r] that are held at once: a whole spline of a small chain, little enough for the caches,
# and no more than that for Fourier features.
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

    def applied(self, displacement: Tensor, velocity: Tensor, acceleration: Tensor) -> Tensor:
        """(I, S, n), the rows times a motion (I, S, n), parameters held."""
        out = (self.stiffness * _neighbours(displacement) + self.damping * _neighbours(velocity)).sum(-1)
        return out if self.mass is None else out + self.mass * acceleration

    def jacobian(self, segments: Segments, dofs: slice) -> Tensor:
        """The given DOFs' rows by the features of DOFs i-1, i, i+1 in this order, (I, dofs, S, 3 B)."""
        displacement, velocity = (phi[:, None, :, None, :] for phi in (segments.displacement, segments.velocity))
        stiffness, damping = (x[:, :, dofs].movedim(2, 1)[..., None] for x in (self.stiffness, self.damping))
        out = displacement * stiffness
        out.addcmul_(velocity, damping)
        if self.mass is not None:
            out[..., 1, :] += segments.acceleration[:, None] * self.mass[dofs, None, None]
        return out.flatten(3)


def _next_connection(x: Tensor) -> Tensor:
    """Value of connection i+1 in the place of connection i, 0 at the end of the chain."""
    return torch.cat((x[..., 1:], torch.zeros_like(x[..., :1])), -1)


def _tridiagonal(x: Tensor) -> Tensor:
    """Derivative of r_i - r_{i+1} by the motion of DOFs i-1, i, i+1, from dr_i/de_i, (..., n) to (..., n, 3)."""
    after = _next_connection(x)
    return torch.stack((-x, x + after, -after), -1)


def _neighbours(x: Tensor) -> Tensor:
    """Motion of DOFs i-1, i, i+1, (..., n) to (..., n, 3); neither the ground nor what is beyond the end moves."""
    zero = torch.zeros_like(x[..., :1])
    return torch.stack((torch.cat((zero, x[..., :-1]), -1), x, torch.cat((x[..., 1:], zero), -1)), -1)
