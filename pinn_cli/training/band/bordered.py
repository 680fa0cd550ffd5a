"""Symmetric positive definite systems that are a band with a border: many readout weights, few system parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpbtrf, dtbtrs
from scipy.optimize import nnls

from pinn_cli.training.band.triangular_bands import solve_factored

# Added to the diagonal of the scaled matrix (all ones) in every factorisation: a few times the rounding error of its
# largest entry.
ROUNDING_JITTER = 1e-14
# Steps that a bounded solution may take per parameter; one or two is the rule.
NNLS_STEPS = 100


@dataclass(frozen=True, eq=False)
class BorderedSystem:
    """Normal equations [[A, B], [B^T, C]] [w, x] = -[g, h], in float64 on the CPU, where LAPACK's band solvers are.

    Attributes:
        band: Lower band of A, (half_width + 1, size); entry [i - j, j] is A[i, j].
        border: B, (size, p).
        corner: C, (p, p).
        gradient: g, (size,).
        corner_gradient: h, (p,).
    """

    band: np.ndarray
    border: np.ndarray
    corner: np.ndarray
    gradient: np.ndarray
    corner_gradient: np.ndarray

    def factor(self, damping: float = 0.0) -> BorderedFactor | None:
        """Cholesky factors with the diagonal scaled to one plus ``damping``; None if not positive definite."""
        eliminated = self.eliminated(damping)
        return None if eliminated is None else eliminated.factor(eliminated.complement)

    def eliminated(self, damping: float = 0.0) -> Eliminated | None:
        """The readout weights eliminated, damped likewise; None if A is not positive definite."""
        scale = np.sqrt(self.band[0])
        if not np.all(np.isfinite(scale)) or np.any(scale == 0):
            return None
        scaled = self.band.copy()
        width = self.band.shape[1]
        for k in range(len(scaled)):
            scaled[k, : width - k] /= scale[: width - k] * scale[k:]
        scaled[0] += damping + ROUNDING_JITTER
        factor, failed = dpbtrf(scaled, lower=1, overwrite_ab=1)
        if failed:
            return None
        solved = _band_solve(factor, scale, self.border)
        schur = self.corner - self.border.T @ solved
        schur[np.diag_indices_from(schur)] += damping * np.diag(self.corner)
        return Eliminated(factor, scale, solved, schur)


@dataclass(frozen=True, eq=False)
class Eliminated:
    """A :class:`BorderedSystem` without its readout weights.

    Attributes:
        band, scale, solved_border: See :class:`BorderedFactor`.
        complement: Schur complement C - B^T A^-1 B, (p, p), its corner damped.
    """

    band: np.ndarray
    scale: np.ndarray
    solved_border: np.ndarray
    complement: np.ndarray

    def factor(self, complement: np.ndarray) -> BorderedFactor | None:
        """With the complement's Cholesky factor; None if it is not positive definite.

        Args:
            complement: (p, p), its own, or that of several systems which share their parameters.
        """
        try:
            schur = np.linalg.cholesky((complement + complement.T) / 2.0)
        except np.linalg.LinAlgError:
            return None
        return BorderedFactor(self.band, self.scale, self.solved_border, schur)


@dataclass(frozen=True, eq=False)
class BorderedFactor:
    """A factored :class:`BorderedSystem`.

    Attributes:
        band: Lower band of the Cholesky factor of the scaled A.
        scale: Square root of A's diagonal; A = scale * scaled A * scale.
        solved_border: A^-1 B, (size, p).
        schur: Cholesky factor of C - B^T A^-1 B, (p, p).
    """

    band: np.ndarray
    scale: np.ndarray
    solved_border: np.ndarray
    schur: np.ndarray

    def step(self, system: BorderedSystem, lower: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Solution (w, x) of the system: the least of its quadratic form, with x >= lower if that is given.

        With the readout weights eliminated the bounded problem is as small as the parameters are few, so the bounds
        are met exactly and not by a penalty or a transformation.
        """
        free, right = self.reduced(system)
        x = self.of_parameters(right, lower)
        return -free - self.solved_border @ x, x

    def readout_step(self, system: BorderedSystem) -> np.ndarray:
        """W (size,) of the system's solution with the parameters held."""
        return -_band_solve(self.band, self.scale, system.gradient)

    def reduced(self, system: BorderedSystem) -> tuple[np.ndarray, np.ndarray]:
        """A^-1 g (size,), and the right-hand side (p,) of the parameters with the readout weights eliminated."""
        free = _band_solve(self.band, self.scale, system.gradient)
        return free, system.border.T @ free - system.corner_gradient

    def of_parameters(self, right: np.ndarray, lower: np.ndarray | None = None) -> np.ndarray:
        """X (p,) of that right-hand side, with x >= lower if that is given."""
        x: np.ndarray = self.corner_covariance @ right
        return self._bounded(right, lower) if lower is not None and np.any(x < lower) else x

    def _bounded(self, right: np.ndarray, lower: np.ndarray) -> np.ndarray:
        """The x >= lower (lower <= 0) that makes |R^T x - R^-1 right| least, R R^T the Schur complement.

        With the unbounded x first and R^T = Q T, T upper triangular, the others are a non-negative least-squares
        problem in the rows of T below. Lawson and Hanson's method ends at its solution; scipy's bounded one (bvls)
        stops short where a freed variable is blocked at once.
        """
        lower, unit = np.minimum(lower, 0.0), 1.0 / np.linalg.norm(self.schur, axis=1)
        order = np.argsort(np.isfinite(lower), kind="stable")
        free, bound = np.split(order, [int(np.isinf(lower).sum())])
        q, t = np.linalg.qr((self.schur.T * unit)[:, order])
        target = q.T @ solve_triangular(self.schur, right, lower=True)
        n, least = len(free), lower[bound] / unit[bound]
        above, _ = nnls(t[n:, n:], target[n:] - t[n:, n:] @ least, maxiter=NNLS_STEPS * len(order))
        x = np.empty(len(order))
        x[bound] = lower[bound] + unit[bound] * above
        x[free] = unit[free] * solve_triangular(t[:n, :n], target[:n] - t[:n, n:] @ (least + above))
        return x

    @property
    def corner_covariance(self) -> np.ndarray:
        """(p, p), covariance of the parameters, readout weights marginalised: the Schur complement's inverse."""
        inverse = solve_triangular(self.schur, np.eye(len(self.schur)), lower=True)
        return inverse.T @ inverse

    @property
    def readout_log_determinant(self) -> float:
        """Logarithm of the determinant of A."""
        return 2.0 * float(np.log(self.band[0]).sum() + np.log(self.scale).sum())

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the whole matrix."""
        return self.readout_log_determinant + self.parameter_log_determinant

    @property
    def parameter_log_determinant(self) -> float:
        """Logarithm of the determinant of the Schur complement."""
        return 2.0 * float(np.log(np.diag(self.schur)).sum())

    def draws(self, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Readout weights (size, count) and parameters (p, count) with the inverse as covariance.

        Args:
            normals: (size + p, count), independent standard ones.
        """
        size = len(self.scale)
        x = solve_triangular(self.schur, normals[size:], lower=True, trans="T")
        w, _ = dtbtrs(self.band, normals[:size], uplo="L", trans="T")
        return w / self.scale[:, None] - self.solved_border @ x, x

    def deviations(self, rows: np.ndarray, by_parameter: np.ndarray) -> np.ndarray:
        """(q,), standard deviations of linear functions of weights and parameters, with the inverse as covariance.

        Args:
            rows: (size, q), by the readout weights.
            by_parameter: (p, q).
        """
        own, _ = dtbtrs(self.band, rows / self.scale[:, None], uplo="L")
        through = solve_triangular(self.schur, by_parameter - self.solved_border.T @ rows, lower=True)
        deviation: np.ndarray = np.sqrt(np.sum(own**2, axis=0) + np.sum(through**2, axis=0))
        return deviation

    def inverse_band(self) -> np.ndarray:
        """The entries of A^-1 inside the band of A, (half_width + 1, size), laid out like the band itself.

        Block form of the recursion of Takahashi et al. (1973): with blocks as wide as the band, the factor is block
        bidiagonal, and the inverse's diagonal and first sub-diagonal blocks follow from the last to the first.
        """
        width, size = max(len(self.band) - 1, 1), self.band.shape[1]
        out = np.zeros_like(self.band)
        below = np.zeros((0, 0))
        for start in range((size - 1) // width * width, -1, -width):
            stop, end = min(start + width, size), min(start + 2 * width, size)
            inverse = solve_triangular(
                _dense_block(self.band, start, stop, start, stop), np.eye(stop - start), lower=True
            )
            gain = _dense_block(self.band, stop, end, start, stop) @ inverse
            coupling = -below @ gain
            diagonal = inverse.T @ inverse - gain.T @ coupling
            _store_columns(out, np.vstack((diagonal, coupling)), start)
            below = diagonal
        for k in range(len(out)):
            out[k, : size - k] /= self.scale[: size - k] * self.scale[k:]
        return out


def _band_solve(factor: np.ndarray, scale: np.ndarray, right: np.ndarray) -> np.ndarray:
    scale = scale if right.ndim == 1 else scale[:, None]
    return solve_factored(factor, right / scale) / scale


def _dense_block(band: np.ndarray, row_start: int, row_stop: int, column_start: int, column_stop: int) -> np.ndarray:
    """Rows and columns of the lower triangular matrix whose lower band is given, as a dense array."""
    offset = np.arange(row_start, row_stop)[:, None] - np.arange(column_start, column_stop)
    inside = (offset >= 0) & (offset < len(band))
    columns = np.broadcast_to(np.arange(column_start, column_stop), offset.shape)
    return np.where(inside, band[np.where(inside, offset, 0), columns], 0.0)


def _store_columns(band: np.ndarray, block: np.ndarray, start: int) -> None:
    """Write the lower-band part of dense columns, whose first row and column are ``start``, into the band."""
    rows, columns = block.shape
    for k in range(min(len(band), rows)):
        length = min(columns, rows - k)
        band[k, start : start + length] = block[np.arange(length) + k, np.arange(length)]
