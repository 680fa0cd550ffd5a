"""A mode by the lines around it: under measured inputs by its response, under others by its power spectrum.

**Measured inputs**: the local rational method in partial fractions (McKelvey and Guerin, IFAC Proceedings Volumes
45(16), 2012). In a band around the mode the whole record's spectra obey

    Y = sum over poles (r U + t) / (i omega - p) + B U + T

with r and t of every sensor and polynomials B and T: other modes, and the motion before and after the record. No window
is used, so damping does not come out too large; any input will do, blows of a hammer and single lines included. The
poles are the same for all sensors; all else is linear, and is eliminated (variable projection, Kaufman, BIT 15, 1975).

**Forces that nobody measured**: the sensors are weighed such that the mode stands out most, and the periodogram of
their sum obeys the likelihood of Whittle (Arkiv foer Matematik 2(23), 1953) for

    E[power] = sum over poles Re(a G_p) + b + c f,    G_p = 2 sum over lags (1 - lag / N) exp(p lag) cos(omega lag)

G_p is what a mode under forces of even power shows in a record of N samples without a window, leakage included
(Sykulski and others, Biometrika 106, 2019); the imaginary part of `a` is a slope of the forces' power. One shape takes
part in all of a mode's motion (Au, Operational Modal Analysis, 2017): the rest of the sensors' spectra is another's.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pinn_cli.record.identification.lines import Lines, Pole, RecordMode, normalised, scatter, widened

# Degree of the polynomials; lines for every column; and inputs have so many more lines of power than columns.
DEGREE, LINES_OF_COLUMN, MORE_LINES = 3, 3.0, 3.0
FIT_STEPS, LARGEST_LEVERAGE = 30, 0.7
# What the variances of a frequency and a damping ratio are of those to first order: measured, see `widened`.
WIDENED_RESPONSE = 1.1, 1.1
# Lines of a band at least; the sensors' other motion is taken to be even in this part; lines that tell of it.
FEWEST_IN_BAND_FIT, SHRUNK, FEWEST_OUTSIDE = 40, 0.05, 4
# What a model of the power is at least, of the band's least.
LEAST_OF_POWER, SCORING_STEPS = 0.02, 60
# An envelope that is so steady is a machine's, where a mode's would have changed so often.
STEADY, FEWEST_TIMES = 1.4, 25.0
# A line counts for the shape by this power of the mode's part in it.
OWN_POWER = 6
# Part of the lines that is independent under Hann's window.
HANN = 18.0 / 35.0
# What the variances of a frequency and a damping ratio are of those to first order: measured, see `widened`.
WIDENED_POWER = 1.3, 1.0
# An edge has so many lines to either side; of the logarithm of the likelihood, by how much a mode is better than one.
EDGE_LINES, LIKELIER = 4, 15.0


class BandFit:
    """A mode in a band, beside other modes: those in the band are free, those within so many of its widths are held."""

    def __init__(self, band: Lines, pole: Pole, neighbours: Sequence[Pole], near: float) -> None:
        self.band, self.pole, f = band, pole, band.frequency
        self.reach = f[-1] - f[0]
        self.free = tuple(other for other in neighbours if f[0] < other.frequency < f[-1])
        self.held = tuple(
            other for other in neighbours
            if other not in self.free and f[0] - near * self.reach < other.frequency < f[-1] + near * self.reach
        )  # fmt: skip


class ResponseFit(BandFit):
    """Under measured inputs, see the top of this page."""

    def __init__(self, lines: Lines, pole: Pole, neighbours: Sequence[Pole]) -> None:
        columns = (2 + DEGREE) * (lines.inputs.shape[1] + 1)
        band = lines.around(pole, int(LINES_OF_COLUMN * columns))
        while (
            band.filled < (2 + DEGREE) + MORE_LINES
            and band.frequency[-1] - band.frequency[0] < 0.5 * pole.frequency
            and len(band.frequency) < len(lines.frequency) // 2
        ):
            band = lines.around(pole, int(1.5 * len(band.frequency)))
        super().__init__(band, pole, neighbours, near=0.5)
        place = (band.frequency - pole.frequency) / max(self.reach, 1e-300)
        self.powers = place[:, None] ** np.arange(DEGREE + 1)
        self.scale = 2.0 * np.pi * max(pole.frequency * pole.damping, 1.0 / band.duration)
        level = np.sqrt(np.mean(np.abs(band.outputs) ** 2, axis=0))
        self.y = band.outputs / np.where(level > 0.0, level, 1.0)
        push = np.sqrt(np.mean(np.abs(band.inputs) ** 2, axis=0))
        self.u = band.inputs / np.where(push > 0.0, push, 1.0)

    @property
    def determined(self) -> bool:
        """Whether there are lines enough, of the inputs too."""
        columns = len(self.free) + len(self.held) + 2 + DEGREE
        return len(self.y) > columns * (self.u.shape[1] + 1) + 8 and self.band.filled >= columns + MORE_LINES - 1

    def _resonances(self, poles: Sequence[Pole]) -> np.ndarray:
        """(L, K)."""
        return self.scale / (2j * np.pi * self.band.frequency[:, None] - np.array([p.at for p in poles]))

    def _basis(self, poles: Sequence[Pole], pushing: np.ndarray) -> np.ndarray:
        """(L, columns): of the first pole under inputs that push it, then all others."""
        first, others = self._resonances(poles[:1]), self._resonances([*poles[1:], *self.held])
        common = np.concatenate((others, self.powers), axis=1)
        return np.concatenate([first * pushing, first, common, *(common * u[:, None] for u in self.u.T)], axis=1)

    def gain(self) -> float:
        """Logarithm of the probability that chance explains as much as the mode's response, of the best sensor."""
        from scipy.stats import f as distribution

        if not self.determined:
            return 0.0
        poles = (self.pole, *self.free)
        less, more = (_residual(self._basis(poles, x), self.y) for x in (self.u[:, :0], self.u))
        columns = self._basis(poles, self.u).shape[1]
        free, added = len(self.y) - columns, self.u.shape[1]
        before, after = (np.sum(np.abs(x) ** 2, axis=0) for x in (less, more))
        ratio = (before - after) / added / np.maximum(after / free, 1e-300)
        return float(distribution.logsf(ratio.max(), 2 * added, 2 * free) + np.log(len(ratio)))

    def solve(self) -> RecordMode | None:
        """By Gauss-Newton; None where it does not settle."""
        poles: list[Pole] = [self.pole, *self.free]
        weights = np.ones(self.y.shape[1])
        for _turn in range(2):
            residual = _residual(self._basis(poles, self.u), self.y)
            size = np.sqrt(np.mean(np.abs(residual) ** 2, axis=0))
            weights = 1.0 / np.maximum(size, 1e-9)
            cost = float(np.sum(np.abs(residual * weights) ** 2))
            for _ in range(FIT_STEPS):
                jacobian, residual, *_ = self._linearised(poles)
                step = _solve(jacobian * weights[:, None], residual * weights)
                step *= min(1.0, 0.5 / max(float(np.max(np.abs(step[1::2]), initial=0.0)), 1e-300))
                step *= min(1.0, 0.05 / max(float(np.max(np.abs(step[::2]), initial=0.0)), 1e-300))
                for _ in range(6):
                    tried = [p.moved(step[2 * i : 2 * i + 2]) for i, p in enumerate(poles)]
                    now = float(np.sum(np.abs(_residual(self._basis(tried, self.u), self.y) * weights) ** 2))
                    if now < cost:
                        break
                    step *= 0.3
                else:
                    break
                poles, settled, cost = tried, cost - now < 1e-6 * cost, now
                if settled:
                    break
        return self._fitted(poles, weights)

    def _linearised(self, poles: Sequence[Pole]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Slopes of what is left (L, S, 2K), itself (L, S), coefficients (columns, S), directions (L, columns)."""
        basis = self._basis(poles, self.u)
        directions, _ = np.linalg.qr(basis)
        coefficients = np.linalg.lstsq(basis, self.y, rcond=1e-12)[0]
        residual = self.y - directions @ (directions.conj().T @ self.y)
        resonances, inputs = self._resonances(poles), self.u.shape[1]
        slopes = []
        for i, pole in enumerate(poles):
            squared = resonances[:, i : i + 1] ** 2 / self.scale
            if i == 0:
                rows = [*range(inputs), inputs]
                through = np.concatenate((squared * self.u, squared), axis=1)
            else:
                others = len(poles) - 1 + len(self.held) + DEGREE + 1
                rows = [inputs + i + others * j for j in range(inputs + 1)]
                through = np.concatenate((squared, squared * self.u), axis=1)
            by_pole = -through @ coefficients[rows]
            by_pole -= directions @ (directions.conj().T @ by_pole)
            slopes += [by_pole * slope for slope in pole.slopes]
        return np.stack(slopes, axis=2), residual, coefficients, directions

    def _fitted(self, poles: Sequence[Pole], weights: np.ndarray) -> RecordMode | None:
        jacobian, residual, coefficients, directions = self._linearised(poles)
        lines, columns = directions.shape
        inputs, w = self.u.shape[1], jacobian * weights[:, None]
        normal = np.einsum("lsa,lsb->ab", w.conj(), w).real
        try:
            inverse = np.linalg.inv(normal)
        except np.linalg.LinAlgError:
            return None
        # Errors are as large as they are; what the fit has taken of a line is put back (MacKinnon and White's HC3).
        of_poles = np.einsum("lsa,ab,lsb->l", w.conj(), inverse, w).real / max(len(weights), 1)
        leverage = np.minimum(np.sum(np.abs(directions) ** 2, axis=1) + of_poles, LARGEST_LEVERAGE)
        scores = np.einsum("lsa,ls->la", w.conj(), residual * weights).real / (1.0 - leverage)[:, None]
        grouped = inverse @ scatter(scores) @ inverse
        errors = residual * weights
        together = errors.conj().T @ errors / (lines - columns)
        even = inverse @ np.einsum("lsa,st,ltb->ab", w.conj(), 0.5 * together.T, w).real @ inverse
        covariance = grouped if np.trace(grouped[:2, :2]) > np.trace(even[:2, :2]) else even
        residues = coefficients[:inputs]  # (F, S)
        strongest = int(np.argmax(np.sum(np.abs(residues) ** 2, axis=1)))
        level = np.sqrt(np.mean(np.abs(self.band.outputs) ** 2, axis=0))
        spread = np.linalg.pinv(self._basis(poles, self.u))[strongest]
        noise = (
            (residual * level).conj().T @ (residual * level) / (lines - columns) * float(np.sum(np.abs(spread) ** 2))
        )
        shape, noise = normalised(residues[strongest] * level, noise)
        mode = self._resonances(poles[:1]) * self.u @ residues
        width = max(poles[0].damping * poles[0].frequency, 1.5 / self.band.duration)
        near = np.abs(self.band.frequency - poles[0].frequency) <= width
        power, other = (np.sum(np.abs(x[near]) ** 2, axis=0) for x in (mode, self.y - mode))
        part = float(np.max(power / np.maximum(power + other, 1e-300)))
        covariance = widened(covariance[:2, :2], poles[0], self.band.duration, WIDENED_RESPONSE)
        return RecordMode(poles[0].frequency, poles[0].damping, covariance, shape, noise, part)


def _residual(basis: np.ndarray, y: np.ndarray) -> np.ndarray:
    directions, _ = np.linalg.qr(basis)
    return np.asarray(y - directions @ (directions.conj().T @ y))


def _solve(jacobian: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """The real step that takes least squares of complex rows down."""
    flat = jacobian.reshape(-1, jacobian.shape[-1])
    rows = np.concatenate((flat.real, flat.imag))
    target = np.concatenate((residual.ravel().real, residual.ravel().imag))
    return np.asarray(-np.linalg.lstsq(rows, target, rcond=1e-10)[0])


class PowerFit(BandFit):
    """Under forces that nobody measured, see the top of this page; the mode's shape (S,) is known roughly."""

    def __init__(self, lines: Lines, pole: Pole, neighbours: Sequence[Pole], shape: np.ndarray) -> None:
        super().__init__(lines.around(pole, FEWEST_IN_BAND_FIT), pole, neighbours, near=1.0)
        f = self.band.frequency
        self.shape, self.weights = shape, self._filter(shape)
        self.power = np.abs(self.band.outputs @ self.weights) ** 2
        self.power = self.power / max(float(self.power.mean()), 1e-300)
        self.spectra: dict[Pole, np.ndarray] = {}
        self.slope = (f - f.mean()) / max(0.5 * self.reach, 1e-300)

    def _filter(self, shape: np.ndarray) -> np.ndarray:
        """(S,), what to multiply the sensors by: the shape against the motion outside of the half-power width."""
        y, away = self.band.outputs, np.abs(self.band.frequency - self.pole.frequency)
        outside = y[away > 3.0 * self.pole.damping * self.pole.frequency + 2.0 / self.band.duration]
        if y.shape[1] == 1:
            return np.ones(1)
        if len(outside) < FEWEST_OUTSIDE:  # as wide as the band
            return shape.conj() / np.linalg.norm(shape)
        covariance = outside.T @ outside.conj() / len(outside)
        even = np.trace(covariance).real / len(covariance)
        held = (1.0 - SHRUNK) * covariance + SHRUNK * even * np.eye(len(covariance))
        return np.asarray(np.linalg.solve(held, shape / np.linalg.norm(shape)).conj())

    def _shown(self, pole: Pole) -> np.ndarray:
        """(L, 2) of G for both parts of a, scaled."""
        if pole not in self.spectra:
            decay, omega = pole.at * self.band.step, 2.0 * np.pi * self.band.frequency * self.band.step
            g = _folded(decay - 1j * omega, self.band.samples) + _folded(decay + 1j * omega, self.band.samples)
            self.spectra[pole] = np.stack((g.real, -g.imag), axis=1) * abs(decay.real)
        return self.spectra[pole]

    def _shapes(self, poles: Sequence[Pole]) -> np.ndarray:
        """(L, 2K)."""
        return np.concatenate([np.zeros((len(self.power), 0)), *map(self._shown, poles)], axis=1)

    def _slopes(self, pole: Pole, amplitude: np.ndarray) -> list[np.ndarray]:
        """Of a mode's power by the logarithms of its frequency and damping."""
        steps = np.diag([1e-5 * max(pole.damping, 1e-3), 1e-4])
        return [(self._shown(pole.moved(by)) - self._shown(pole)) @ amplitude / by.sum() for by in steps]

    def gain(self) -> float:
        """Logarithm of the probability that chance makes as much of a peak; <= 0."""
        from scipy.stats import chi2

        less, more = (self._scored(poles, 0)[2] for poles in ([*self.free], [self.pole, *self.free]))
        return float(chi2.logsf(max(2.0 * (less - more), 0.0), 4))

    def _background(self) -> np.ndarray:
        common = np.stack((np.ones(len(self.power)), self.slope), axis=1)
        return np.concatenate((common, self._shapes(self.held)[:, ::2]), axis=1) if self.held else common

    def _scored(self, poles: list[Pole], moving: int) -> tuple[list[Pole], np.ndarray, float, np.ndarray]:
        """Fisher scoring; the first ``moving`` poles are free."""
        background = self._background()
        floor = LEAST_OF_POWER * float(np.quantile(self.power, 0.2)) + 1e-9
        linear = np.concatenate((self._shapes(poles), background), axis=1)
        size = np.maximum(np.max(np.abs(linear), axis=0), 1e-300)
        values = np.zeros(linear.shape[1])
        # A start: peaks take what stands above the quiet lines.
        quiet = float(np.quantile(self.power, 0.3))
        values[2 * len(poles)] = max(quiet, floor)
        for i in range(len(poles)):
            top = float(np.max(self.power)) if i == 0 else quiet
            values[2 * i] = 0.3 * top / size[2 * i]

        def level(at: np.ndarray, shown: np.ndarray) -> np.ndarray:
            return np.maximum(shown @ at, floor)

        def cost(expected: np.ndarray) -> float:
            return float(np.sum(np.log(expected) + self.power / expected))

        expected = level(values, linear)
        now = cost(expected)
        for _ in range(SCORING_STEPS):
            moved = [s for i in range(moving) for s in self._slopes(poles[i], values[2 * i : 2 * i + 2])]
            jacobian = np.concatenate((np.stack(moved, axis=1), linear), axis=1) if moved else linear
            scaled = jacobian / expected[:, None]
            norm = np.maximum(np.linalg.norm(scaled, axis=0), 1e-300)
            step = np.linalg.lstsq(scaled / norm, (self.power - expected) / expected, rcond=1e-8)[0] / norm
            of_poles = step[: 2 * moving].reshape(-1, 2)
            most = np.array([[0.5 * max(p.damping, 0.005), 0.5] for p in poles[:moving]]).reshape(-1, 2)
            step = step / max(1.0, float(np.max(np.abs(of_poles) / most, initial=0.0)))
            for _ in range(8):
                tried = [p.moved(step[2 * i : 2 * i + 2]) if i < moving else p for i, p in enumerate(poles)]
                others = values + step[2 * moving :]
                shown = np.concatenate((self._shapes(tried), background), axis=1) if moving else linear
                fresh = level(others, shown)
                then = cost(fresh)
                if then < now:
                    break
                step = 0.4 * step
            else:
                break
            poles, values, linear, expected, settled, now = tried, others, shown, fresh, now - then < 1e-3, then
            if settled:
                break
        return poles, values, now, expected

    def solve(self) -> RecordMode | None:
        """None where an edge of the spectrum says as much."""
        poles, values, cost, expected = self._scored([self.pole, *self.free], moving=1 + len(self.free))
        if not values[:2].any() or _edge(self.power) < cost + LIKELIER:
            return None
        moved = [s for i, p in enumerate(poles) for s in self._slopes(p, values[2 * i : 2 * i + 2])]
        linear = np.concatenate((self._shapes(poles), self._background()), axis=1)
        jacobian = np.concatenate((np.stack(moved, axis=1), linear), axis=1) / expected[:, None]
        norm = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
        jacobian = jacobian / norm
        inverse = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-10, hermitian=True)
        residual = (self.power - expected) / expected
        leverage = np.minimum(np.einsum("la,ab,lb->l", jacobian, inverse, jacobian), 0.7)
        scores = jacobian * (residual / (1.0 - leverage))[:, None]
        grouped = inverse @ scatter(scores) @ inverse / np.outer(norm, norm)
        even = inverse / np.outer(norm, norm)
        covariance = (even if np.trace(even[:2, :2]) > np.trace(grouped[:2, :2]) else grouped)[:2, :2]
        covariance = widened(covariance, poles[0], self.band.duration, WIDENED_POWER)
        peak = self._shapes(poles[:1]) @ values[:2]
        share = np.clip(peak / expected, 0.0, 1.0)
        top = int(np.argmax(peak))
        shape, noise = self._shape(share, expected)
        return RecordMode(poles[0].frequency, poles[0].damping, covariance, shape, noise, float(share[top]))

    @property
    def is_steady(self) -> bool:
        """Whether the motion is that of a machine: its envelope does not come and go as that of a mode does.

        The fourth moment of an envelope over the square of its second is 2 of a mode under random forces, 1 of a sine.
        """
        half = max(3.0 * self.pole.damping * self.pole.frequency, 3.0 / self.band.duration)
        near = np.abs(self.band.frequency - self.pole.frequency) <= half
        envelope = np.abs(np.fft.ifft((self.band.outputs @ self.weights)[near], 4 * int(near.sum()))) ** 2
        times = 2.0 * np.pi * self.pole.damping * self.pole.frequency * self.band.duration
        return bool(times > FEWEST_TIMES and np.mean(envelope**2) < STEADY * np.mean(envelope) ** 2)

    def _shape(self, share: np.ndarray, expected: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of what goes together with the weighed sum of the sensors, where that is the mode's."""
        y = self.band.outputs
        y = y[1:-1] - 0.5 * (y[:-2] + y[2:])  # Hann's window: a machine's line far away has left its mark in every line
        coordinate = y @ self.weights
        rough = self.shape / ((self.weights @ self.shape) or 1.0)
        off = np.sum(np.abs(y - coordinate[:, None] * rough) ** 2, axis=1)  # large where a machine runs
        usual = float(np.median(off)) + 1e-300
        weight = share[1:-1] ** OWN_POWER / expected[1:-1] * (usual / (usual + off)) ** 2
        size = max(float(np.sum(weight * np.abs(coordinate) ** 2)), 1e-140)
        shape = (weight * coordinate.conj()) @ y / size
        residual = y - coordinate[:, None] * shape
        together = (residual.conj() * (weight**2 * np.abs(coordinate) ** 2)[:, None]).T @ residual / size**2
        return normalised(shape, together / HANN)


def _edge(power: np.ndarray) -> float:
    """Minus the logarithm of the likelihood of two levels, one to either side of the best place."""
    below = np.arange(EDGE_LINES, len(power) - EDGE_LINES)
    sums = np.cumsum(power)[below - 1]
    means = np.maximum(sums / below, 1e-300), np.maximum((power.sum() - sums) / (len(power) - below), 1e-300)
    costs = below * np.log(means[0]) + (len(power) - below) * np.log(means[1])
    return float(np.min(costs, initial=np.inf)) + len(power)


def _folded(x: np.ndarray, n: int) -> np.ndarray:
    """Sum over lags from 0 to n - 1 of (1 - lag / n) exp(x lag), the first one by half."""
    e = np.expm1(x)
    return np.asarray(-1.0 / e - np.exp(x) * -np.expm1(n * x) / (n * e**2) - 0.5)
