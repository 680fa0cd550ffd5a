"""A mode under forces that nobody measured, by its power spectrum.

In a band around the mode the sensors are weighed such that it stands out most, and the periodogram of their sum obeys
the likelihood of Whittle (Arkiv foer Matematik 2(23), 1953) for

    E[power] = sum over poles Re(a G_p) + b + c f,    G_p = 2 sum over lags (1 - lag / N) exp(p lag) cos(omega lag)

G_p is what a mode under forces of even power shows in a record of N samples without a window, leakage included
(Sykulski and others, Biometrika 106, 2019); the imaginary part of `a` is a slope of the forces' power. One shape takes
part in all of a mode's motion (Au, Operational Modal Analysis, 2017): the rest of the sensors' spectra is another's.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pinn_cli.record.identification.lines import Lines, Pole, RecordMode, normalised, scatter, widened

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


class PowerFit:
    """See the top of this page.

    Args:
        lines: Of the record.
        pole: Around which.
        neighbours: Other modes.
        shape: (S,), of the mode, roughly.
    """

    def __init__(self, lines: Lines, pole: Pole, neighbours: Sequence[Pole], shape: np.ndarray) -> None:
        self.band, self.pole = lines.around(pole, FEWEST_IN_BAND_FIT), pole
        f = self.band.frequency
        reach = f[-1] - f[0]
        self.free = tuple(other for other in neighbours if f[0] < other.frequency < f[-1])
        self.held = tuple(
            other for other in neighbours
            if other not in self.free and f[0] - reach < other.frequency < f[-1] + reach
        )  # fmt: skip
        self.shape, self.weights = shape, self._filter(shape)
        self.power = np.abs(self.band.outputs @ self.weights) ** 2
        self.power = self.power / max(float(self.power.mean()), 1e-300)
        self.spectra: dict[Pole, np.ndarray] = {}
        self.slope = (f - f.mean()) / max(0.5 * reach, 1e-300)

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
