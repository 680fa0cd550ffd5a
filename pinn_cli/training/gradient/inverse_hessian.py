"""A dense inverse Hessian, learned from gradients by self-scaled Broyden updates."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def update(inverse: Tensor, s: Tensor, y: Tensor, curvature: float, gradient: Tensor) -> Tensor | None:
    """Have H, symmetric and positive definite, learn from a step s and the gradient's change y along it: H y = s.

    The update is a member of Broyden's family (Al-Baali, Spedicato & Maggioni 2014, "Broyden's quasi-Newton methods for
    a nonlinear system of equations and unconstrained optimization"; in the form of Urban, Stefanou & Pons 2025,
    "Unveiling the optimization process of physics informed neural networks", section 2.2):

        H <- (H - H y y' H / y'Hy + phi v v') / tau + s s' / y's,   v = sqrt(y'Hy) (s / y's - H y / y'Hy).

    tau shrinks the old H where it is too small; phi moves between BFGS (1) and DFP (0) and a little beyond. It reads H
    once and writes it once: memory is what an update costs, 128 MB for 4000 weights.

    Args:
        inverse: H, (n, n), changed in place: at thousands of weights it is the largest thing in memory by far.
        s: (n,), the step.
        y: (n,), the gradient's change.
        curvature: s' H^-1 s before the update. After a step of length alpha along -H g it is -alpha s'g.
        gradient: (n,), at the end of the step.

    Returns:
        H times the gradient after the update; None, with H as it was, where the curvature y's is not positive.
    """
    ys = float(y @ s)
    if not ys > torch.finfo(y.dtype).eps * float(s.norm() * y.norm()):
        return None
    hy, hg = (inverse @ torch.stack((y, gradient), dim=1)).unbind(1)
    yhy = float(y @ hy)
    if not (yhy > 0 and curvature > 0 and math.isfinite(yhy)):
        return None
    tau, phi = scaling(curvature / ys, yhy / ys, len(y))
    on_ss = phi * yhy / (tau * ys**2) + 1.0 / ys
    on_sy, on_yy = -phi / (tau * ys), (phi - 1.0) / (tau * yhy)
    left = torch.stack((s, hy))
    right = torch.stack((on_ss * s + on_sy * hy, on_sy * s + on_yy * hy))
    inverse.addmm_(left.T, right, beta=1.0 / tau)
    return hg / tau + left.T @ (right @ gradient)


def scaling(b: float, h: float, count: int) -> tuple[float, float]:
    """Tau and phi of the self-scaled Broyden update of Al-Baali.

    Args:
        b: s' H^-1 s / y's.
        h: y' H y / y's; b h >= 1 by Cauchy and Schwarz.
        count: Number of variables.
    """
    a = max(b * h - 1.0, 0.0)
    if a < 1e-12 or count < 2:  # y is along H^-1 s: all members of the family are one, whatever phi
        return min(1.0, 1.0 / b), 1.0
    rho = min(1.0, h * (1.0 - math.sqrt(a / (1.0 + a))))
    theta = max((rho - 1.0) / a, min(1.0 / rho, (1.0 - b) / b))
    sigma = 1.0 + theta * a
    root = sigma ** (-1.0 / (count - 1))
    plain = min(1.0, 1.0 / b)
    tau = plain * min(root, 1.0 / theta) if theta > 0 else min(plain * root, sigma)
    return tau, (1.0 - theta) / sigma
