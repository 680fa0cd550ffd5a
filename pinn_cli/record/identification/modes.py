"""Modes that a record shows by itself: poles that stay, each then by the lines around it, the clearest first.

A pole that is there at many orders need not be a mode: noise has such poles, and so have machines. Each is tried
against the lines of the whole record's spectrum, beside the modes that were found before it, and kept if chance does
not explain it, if it is wider than a line, and if it is determined.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pinn_cli.record.identification.fits import PowerFit, ResponseFit
from pinn_cli.record.identification.lines import Lines, Pole, RecordMode
from pinn_cli.record.spectrum import decimate

# Logarithm of the probability that chance makes a mode; part of the motion at its peak that is its own, at least.
CHANCE, LEAST_OF_ITS_OWN = -16.0, 0.5
# Deviations of the logarithms of a frequency that is determined, and of a damping ratio of which anything is known;
# lines in a half-power width, at least.
MOST_UNCERTAIN, MOST_UNCERTAIN_DAMPING, NARROWEST = 0.02, 1.2, 0.5
# Modes nearer than this part of their half-power width are one, unless their shapes differ.
ONE, OTHER_SHAPE = 1.0, 0.5
# So many poles are tried, and periods of the record are needed.
MOST_TRIED, FEWEST_PERIODS = 60, 8.0


@dataclass(frozen=True, eq=False)
class Identified:
    """What a record shows.

    Attributes:
        modes: By frequency.
        machines: Frequencies of steady lines that look like modes, Hz.
        stabilisation: All poles.
        tones: Of every input, see :class:`pinn_cli.record.identification.lines.Lines`.
    """

    modes: Sequence[RecordMode]
    machines: Sequence[float]
    stabilisation: Stabilisation
    tones: Sequence[np.ndarray]


def identify(outputs: np.ndarray, inputs: np.ndarray, step: float) -> Identified:
    """Find the modes of a record with a step, s: of sensors (N, S), and what acts (N, F) as far as it was measured."""
    poles = stabilisation(outputs, inputs, step)
    lines = Lines.of(_levelled(outputs), _levelled(inputs), step)
    tried = []
    for f, damping, shape in poles.clusters():
        candidate = Pole(f, max(damping, 1e-4))
        if f * lines.duration > FEWEST_PERIODS:
            tried.append((_fit(lines, candidate, (), shape).gain(), candidate, shape))
    tried = sorted(tried, key=lambda candidate: candidate[0])[:MOST_TRIED]
    accepted: list[tuple[Pole, np.ndarray]] = []
    lone: list[Pole] = []
    for gain, candidate, shape in tried:
        neighbours = [*(pole for pole, _ in accepted), *lone]
        if gain > CHANCE or any(_same(candidate, shape, *other) for other in accepted):
            continue
        fit = _fit(lines, candidate, neighbours, shape)
        if neighbours and fit.gain() > CHANCE:
            continue
        fitted = fit.solve()
        if fitted is None:
            continue
        pole = Pole(fitted.frequency, fitted.damping)
        if _is_line(fit, pole, lines):
            lone.append(pole)
        elif _holds(fitted, candidate, lines) and not any(_same(pole, fitted.shape, *other) for other in accepted):
            accepted.append((pole, shape))
    modes = []
    for pole, shape in accepted:
        neighbours = [*(other for other, _ in accepted if other is not pole), *lone]
        fitted = _fit(lines, pole, neighbours, shape).solve()
        if fitted is not None and _holds(fitted, pole, lines):
            modes.append(fitted)
    modes.sort(key=lambda mode: mode.frequency)
    return Identified(modes, sorted(pole.frequency for pole in lone), poles, lines.tones)


def _levelled(values: np.ndarray) -> np.ndarray:
    """Without the line from the first samples to the last: where they differ, that step is in every line."""
    few = max(1, len(values) // 500)
    first, last = values[:few].mean(axis=0), values[-few:].mean(axis=0)
    return np.asarray(values - first - np.linspace(0.0, 1.0, len(values))[:, None] * (last - first))


def _fit(lines: Lines, pole: Pole, neighbours: Sequence[Pole], shape: np.ndarray) -> ResponseFit | PowerFit:
    if lines.inputs.shape[1]:
        return ResponseFit(lines, pole, neighbours)
    return PowerFit(lines, pole, neighbours, shape)


def _same(pole: Pole, shape: np.ndarray, other: Pole, its_shape: np.ndarray) -> bool:
    width = ONE * max(pole.damping * pole.frequency, other.damping * other.frequency)
    alike = len(shape) == 1 or assurance(shape[None], its_shape[None])[0, 0] > OTHER_SHAPE
    return abs(pole.frequency - other.frequency) < width and bool(alike)


def _is_line(fit: ResponseFit | PowerFit, pole: Pole, lines: Lines) -> bool:
    """Whether it is a sine: as narrow as a line, or as steady."""
    if not isinstance(fit, PowerFit):
        return False
    return 2.0 * pole.damping * pole.frequency * lines.duration < NARROWEST or fit.is_steady


def _holds(mode: RecordMode, start: Pole, lines: Lines) -> bool:
    """Whether it is a vibration, determined, and has not run away from where it was looked for."""
    variance, of_damping = np.diag(mode.covariance)
    width = max(start.damping, mode.damping) * start.frequency + 2.0 / lines.duration
    return bool(
        np.isfinite(mode.covariance).all()
        and abs(mode.frequency - start.frequency) < 2.0 * width
        and 0.0 < variance**0.5 < MOST_UNCERTAIN
        and 0.0 < of_damping**0.5 < MOST_UNCERTAIN_DAMPING
        and mode.damping < MOST_DAMPED
        and 2.0 * mode.damping * mode.frequency * lines.duration > NARROWEST
        and mode.explained > LEAST_OF_ITS_OWN
    )


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
    """Order, its poles (P, 2), frequency in Hz and damping ratio, and their shapes (P, S); nothing without a sensor."""
    if not sensors:
        return
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
