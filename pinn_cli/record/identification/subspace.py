"""Poles of a record by covariance-driven subspace identification (SSI-cov), with what the inputs explain taken out.

Peeters and De Roeck, Mechanical Systems and Signal Processing 13 (1999) 855, with the canonical weights of Van
Overschee and De Moor, Subspace Identification for Linear Systems (1996); where inputs are measured, what follows from
the future ones is projected out of the covariances (the same book, chapter 4). Without inputs nothing is projected.

A record is looked at on several scales of time, each half as fast as the one before: a block of lags then spans some
periods of every mode, whatever the sampling rate.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pinn_cli.record.spectrum import decimate

# Lags of a block: between these, and in all with the sensors as many rows; the highest order, of how many states.
FEWEST_LAGS, MOST_LAGS, BLOCK_ROWS, HIGHEST_ORDER = 10, 30, 80, 24
# Samples of a scale at least, and of every row of the two blocks; the part of its sampling rate in which poles are
# read: of the slowest one the lower.
FEWEST_OF_SCALE, SAMPLES_OF_A_ROW, LOWEST_PART, HIGHEST_PART, LOWEST_OF_LAST = 160, 3.0, 0.16, 0.45, 0.02
# Two orders have the same pole, relative in frequency, in damping ratio, and by the modal assurance criterion.
SAME_FREQUENCY, SAME_DAMPING, SAME_RATIO, SAME_SHAPE = 0.01, 0.25, 0.002, 0.9
# Damping ratios of a vibration; part of the orders in which a stable pole is there; more sensors are taken together.
MOST_DAMPED, PART_OF_ORDERS, MOST_SENSORS = 0.2, 0.2, 8
# Added to a matrix of covariances, of its mean power.
RIDGE = 1e-7


@dataclass(frozen=True, eq=False)
class Stabilisation:
    """Poles by order, of all scales; N poles, S sensors.

    Attributes:
        frequency: (N,), Hz.
        damping: (N,), ratios.
        order: (N,), states of the model.
        scale: (N,), number of the scale.
        shapes: (N, S), complex; in the sensors' units.
        stable: (N,) bool, whether the order before has the same pole.
        orders: How many orders each scale has.
    """

    frequency: np.ndarray
    damping: np.ndarray
    order: np.ndarray
    scale: np.ndarray
    shapes: np.ndarray
    stable: np.ndarray
    orders: int

    def clusters(self) -> list[tuple[float, float, np.ndarray]]:
        """Frequency (Hz), damping ratio and shape (S,) of poles that stay from order to order, by frequency."""
        clusters: list[tuple[float, float, np.ndarray]] = []
        for scale in np.unique(self.scale):
            rest = np.flatnonzero(self.stable & (self.scale == scale))
            while len(rest):
                near = _alike(self, rest, rest)
                heaviest = int(np.argmax(near.sum(axis=1)))
                members = rest[near[heaviest]]
                if len(members) < max(2.0, PART_OF_ORDERS * self.orders):
                    break
                middle = members[np.argsort(self.damping[members])[len(members) // 2]]
                clusters.append(
                    (float(np.median(self.frequency[members])), float(self.damping[middle]), self.shapes[middle])
                )
                rest = rest[~near[heaviest]]
        return sorted(clusters, key=lambda pole: pole[0])


def _alike(poles: Stabilisation, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """(rows, columns) bool, whether poles are the same in frequency and shape."""
    f, g = poles.frequency[rows], poles.frequency[columns]
    width = SAME_FREQUENCY + poles.damping[rows]
    close = np.abs(f[:, None] - g) < width[:, None] * f[:, None]
    return np.asarray(close & (assurance(poles.shapes[rows], poles.shapes[columns]) > SAME_SHAPE))


def assurance(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(A, B), modal assurance criterion of shapes (A, S) and (B, S): 1 where they are the same."""
    power = np.sum(np.abs(first) ** 2, axis=1)[:, None] * np.sum(np.abs(second) ** 2, axis=1)
    return np.asarray(np.abs(first.conj() @ second.T) ** 2 / np.maximum(power, 1e-300))


def stabilisation(outputs: np.ndarray, inputs: np.ndarray, step: float) -> Stabilisation:
    """Poles of orders 2, 4, ... on all scales, of sensors (N, S) and what acts (N, F), F perhaps 0, at a step, s."""
    values, sensors = np.concatenate((outputs, inputs), axis=1), outputs.shape[1]
    rows, orders = [], 0
    for scale, (part, its_step, bottom) in enumerate(_scales(values, step)):
        last = np.zeros((0, 2)), np.zeros((0, sensors))
        for order, poles, shapes in _by_order(part, sensors, its_step):
            orders = max(orders, order // 2)
            (f, damping), (g, d) = poles.T[:, :, None], last[0].T
            same = (np.abs(f - g) < SAME_FREQUENCY * g) & (np.abs(damping - d) < SAME_DAMPING * d + SAME_RATIO)
            stable = (same & (assurance(shapes, last[1]) > SAME_SHAPE)).any(axis=1)
            within = np.flatnonzero((poles[:, 0] >= bottom) & (poles[:, 0] <= HIGHEST_PART / its_step))
            rows += [(*poles[i], order, scale, stable[i], *shapes[i]) for i in within]
            last = poles, shapes
    table = np.array(rows).reshape(len(rows), 5 + sensors)
    f, damping, order, scales, stable = table[:, :5].real.T
    return Stabilisation(f, damping, order.astype(int), scales.astype(int), table[:, 5:], stable > 0, orders)


def _scales(values: np.ndarray, step: float) -> Iterator[tuple[np.ndarray, float, float]]:
    """The channels at their own rate, at half of it, and so on; the step, and from where on poles are read, Hz."""
    while len(values) >= 2 * FEWEST_OF_SCALE:
        yield values, step, LOWEST_PART / step
        values, step = decimate(values, 2), 2.0 * step
    yield values, step, LOWEST_OF_LAST / step


def _by_order(values: np.ndarray, sensors: int, step: float) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Order, its poles (P, 2), frequency in Hz and damping ratio, and their shapes (P, S)."""
    size = np.maximum(values[:, :sensors].std(axis=0), 1e-300)
    moving, back = values[:, :sensors] / size, np.diag(size)
    if sensors > MOST_SENSORS:  # their principal components instead
        directions = np.linalg.svd(np.cov(moving.T), hermitian=True)[0][:, :MOST_SENSORS]
        moving, back, sensors = moving @ directions, size[:, None] * directions, MOST_SENSORS
    values = np.concatenate((moving, values[:, len(size) :]), axis=1)
    lags = min(BLOCK_ROWS / sensors, len(values) / (SAMPLES_OF_A_ROW * values.shape[1]), MOST_LAGS)
    observability = _observability(values, sensors, max(int(lags), FEWEST_LAGS))
    if observability is None:
        return
    for order in range(2, min(HIGHEST_ORDER, observability.shape[1], observability.shape[0] - sensors) + 1, 2):
        gamma = observability[:, :order]
        state, *_ = np.linalg.lstsq(gamma[:-sensors], gamma[sensors:], rcond=None)
        discrete, vectors = np.linalg.eig(state)
        with np.errstate(divide="ignore", invalid="ignore"):
            poles = np.log(discrete.astype(complex)) / step
        shapes = (back @ gamma[:sensors] @ vectors).T
        size = np.abs(poles)
        kept = (poles.imag > 1e-9 * size) & (poles.real < 0.0) & (-poles.real < MOST_DAMPED * size)
        yield order, np.stack((size, -poles.real / size), axis=1)[kept] / (2.0 * np.pi, 1.0), shapes[kept]


def _observability(values: np.ndarray, sensors: int, lags: int) -> np.ndarray | None:
    """(lags * S, order), of the canonical correlations between the past and the future of the sensors; None: no motion.

    The factor of every column is the root of its canonical correlation.
    """
    size = values.std(axis=0)
    if not (size > 0.0).all():
        return None
    r = _correlations((values - values.mean(axis=0)) / size, 2 * lags)
    channels = values.shape[1]
    # Blocks of time -lags ... lags - 1; entry (a, b) is the covariance of what is there.
    at = np.arange(2 * lags)
    blocks = r[2 * lags + at[None, :] - at[:, None]]  # (a, b, channel, channel): z_t z_(t + b - a)
    blocks = np.swapaxes(blocks, 1, 2).reshape(2 * lags * channels, -1)
    place = np.arange(2 * lags * channels).reshape(2 * lags, channels)
    past, future, acting = place[:lags].ravel(), place[lags:, :sensors].ravel(), place[lags:, sensors:].ravel()
    if len(acting):
        both, kept = np.concatenate((past, future)), blocks[np.ix_(acting, acting)]
        kept = kept + RIDGE * np.trace(kept) / len(kept) * np.eye(len(kept))
        cross = blocks[np.ix_(acting, both)]
        blocks[np.ix_(both, both)] -= cross.T @ np.linalg.solve(kept, cross)
    future_root, past_root = (_root(blocks[np.ix_(x, x)]) for x in (future, past))
    middle = np.linalg.solve(future_root, np.linalg.solve(past_root, blocks[np.ix_(past, future)]).T)
    left, strength, _ = np.linalg.svd(middle, full_matrices=False)
    gamma = future_root @ left * np.sqrt(strength)
    return np.asarray(gamma.reshape(lags, sensors, -1) * size[None, :sensors, None]).reshape(lags * sensors, -1)


def _root(matrix: np.ndarray) -> np.ndarray:
    """Lower triangle L of matrix = L L', which need not be quite positive."""
    power = np.trace(matrix) / len(matrix)
    squares, vectors = np.linalg.eigh(matrix)
    held = (vectors * np.maximum(squares, RIDGE * power)) @ vectors.T
    return np.linalg.cholesky(0.5 * (held + held.T))


def _correlations(values: np.ndarray, lags: int) -> np.ndarray:
    """(2 lags + 1, channels, channels), of lags from -lags on: the mean of z_t z_(t + lag)."""
    from scipy.fft import irfft, next_fast_len, rfft

    length = next_fast_len(len(values) + lags, real=True)
    lines = rfft(values, length, axis=0)
    correlations = np.empty((2 * lags + 1, values.shape[1], values.shape[1]))
    for i in range(values.shape[1]):
        together = irfft(lines[:, i, None].conj() * lines, length, axis=0)
        correlations[:, i] = np.concatenate((together[-lags:], together[: lags + 1])) / len(values)
    return correlations
