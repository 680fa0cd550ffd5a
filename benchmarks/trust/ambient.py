"""What an engineer does with ambient vibration: modes by subspace identification, then the model is updated to them.

Covariance-driven stochastic subspace identification (Peeters and De Roeck 1999), and a weighted least-squares fit of
the model's frequencies, damping ratios and shapes with what is believed of its parameters (Friswell and Mottershead
1995). Forces are taken as white.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import svd
from scipy.optimize import least_squares

from benchmarks.trust.told import Samples, Told

PERIODS = 1.5  # of the lowest mode: longest lag of the covariances
LAGS = (6, 120)  # fewest and most samples of that
ORDERS = (1, 2, 3, 4)  # times the DOFs: modes of the systems that are identified
NEAR = 0.25  # relative: how far from the model's frequency a mode may be
PIECES = 4  # of the record, from whose modes those of the whole get their deviations
LEAST = np.array([3e-3, 0.1, 0.02])  # deviations of a frequency and a ratio, relative, and of a shape

Modes = tuple[np.ndarray, np.ndarray, np.ndarray]  # rad/s (m,), ratios (m,), shapes at the sensors (m, r), complex


def subspace(felt: np.ndarray, dt: float, lags: int, orders: list[int]) -> list[Modes]:
    """Modes of systems of these orders, from samples (N, r); unstable and overdamped ones are left out."""
    felt = felt - felt.mean(axis=0)
    (number, r), found = felt.shape, []
    covariance = [felt[i:].T @ felt[: number - i] / (number - i) for i in range(2 * lags)]
    toeplitz = np.block([[covariance[lags + i - j] for j in range(lags)] for i in range(lags)])
    left, sizes, _ = svd(toeplitz, full_matrices=False)
    for order in orders:
        if order > len(sizes) - r:
            break
        seen = left[:, :order] * np.sqrt(sizes[:order])
        values, vectors = np.linalg.eig(np.linalg.lstsq(seen[:-r], seen[r:], rcond=None)[0])
        poles, shapes = np.log(values.astype(complex)) / dt, (seen[:r] @ vectors).T
        vibrate = (poles.imag > 0.0) & (poles.real < 0.0)
        poles = poles[vibrate]
        found.append((np.abs(poles), -poles.real / np.abs(poles), shapes[vibrate]))
    return found


def of_model(told: Told, parameters: np.ndarray) -> Modes:
    """Modes of the model as its sensors show them: of the n pairs of poles, or of those that vibrate."""
    poles, vectors = np.linalg.eig(told.matrix(parameters))
    vibrate = poles.imag > 0.0
    order = np.argsort(np.abs(poles[vibrate]))
    poles, vectors = poles[vibrate][order], vectors[:, vibrate][:, order]
    at = vectors[[sensor.dof for sensor in told.sensors]]
    return np.abs(poles), -poles.real / np.abs(poles), at.T


def _alike(one: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Modal assurance criteria."""
    found: np.ndarray = np.abs(others @ one.conj()) ** 2 / (
        np.sum(np.abs(others) ** 2, axis=-1) * np.sum(np.abs(one) ** 2)
    )
    return found


def _scaled(shape: np.ndarray, like: np.ndarray) -> np.ndarray:
    """The multiple of a shape that is nearest to `like`, as real numbers."""
    along = np.vdot(shape, like) / np.vdot(shape, shape)
    return np.asarray((shape * along).real)


def measured(told: Told, felt: np.ndarray, dt: float, believed: Modes) -> np.ndarray:
    """Logarithms of frequency and ratio, and shape, of the mode that is like each of the model's, (m, 2 + r)."""
    n, lowest = told.ndof, 2.0 * np.pi / believed[0].min()
    lags = int(np.clip(round(PERIODS * lowest / dt), *LAGS))
    systems = subspace(felt, dt, min(lags, len(felt) // 4), [2 * n * times for times in ORDERS])
    rows = np.full((len(believed[0]), 2 + felt.shape[1]), np.nan)
    for i, (frequency, _, shape) in enumerate(zip(*believed, strict=True)):
        like = (shape / shape[np.argmax(np.abs(shape))]).real
        like /= np.linalg.norm(like)
        seen = []
        for frequencies, ratios, shapes in systems:
            far = np.abs(np.log(frequencies / frequency))
            merit = np.where(far < NEAR, _alike(shape, shapes) - (far / NEAR) ** 2, -np.inf)
            if len(merit) and np.isfinite(merit.max()):
                best = int(np.argmax(merit))
                seen.append([np.log(frequencies[best]), np.log(ratios[best]), *_scaled(shapes[best], like)])
        if seen:
            rows[i] = np.median(seen, axis=0)
    return rows


def updated(told: Told, seen: Samples) -> np.ndarray:
    """Parameters with which the model has the modes of the record, (p,)."""
    believed = of_model(told, told.guess)
    whole = measured(told, seen.sensors, seen.dt, believed)
    pieces = np.stack([measured(told, part, seen.dt, believed) for part in np.array_split(seen.sensors, PIECES)])
    least = np.concatenate([LEAST[:2], np.full(len(told.sensors), LEAST[2])])
    scatter = np.nanstd(pieces, axis=0, ddof=1) / np.sqrt(PIECES)
    counts = np.isfinite(whole) & np.isfinite(scatter)
    scatter = np.maximum(np.where(counts, scatter, 1.0), least)

    def missed(logarithms: np.ndarray) -> np.ndarray:
        values = told.guess * np.exp(logarithms)
        frequencies, ratios, shapes = of_model(told, values)
        prior = np.expm1(logarithms) / told.uncertainty
        if len(frequencies) != len(whole):  # a mode no longer vibrates
            return np.concatenate([np.full(counts.sum(), 1e3), prior])
        own = [
            [np.log(f), np.log(z), *_scaled(s, row[2:])]
            for f, z, s, row in zip(frequencies, ratios, shapes, np.nan_to_num(whole), strict=True)
        ]
        return np.concatenate([((np.array(own) - whole) / scatter)[counts], prior])

    return told.guess * np.exp(least_squares(missed, np.zeros(len(told.guess)), loss="soft_l1").x)
