"""A mode under measured inputs, by the local rational method in partial fractions.

McKelvey and Guerin, IFAC Proceedings Volumes 45(16), 2012. In a band around the mode the whole record's spectra obey

    Y = sum over poles (r U + t) / (i omega - p) + B U + T

with r and t of every sensor and polynomials B and T: other modes, and the motion before and after the record. No window
is used, so damping does not come out too large; any input will do, blows of a hammer and single lines included. The
poles are the same for all sensors; all else is linear, and is eliminated (variable projection, Kaufman, BIT 15, 1975).
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


class ResponseFit:
    """See the top of this page.

    Args:
        lines: Of the record.
        pole: Around which.
        neighbours: Other modes.
    """

    def __init__(self, lines: Lines, pole: Pole, neighbours: Sequence[Pole]) -> None:
        columns = (2 + DEGREE) * (lines.inputs.shape[1] + 1)
        band = lines.around(pole, int(LINES_OF_COLUMN * columns))
        while (
            band.filled < (2 + DEGREE) + MORE_LINES
            and band.frequency[-1] - band.frequency[0] < 0.5 * pole.frequency
            and len(band.frequency) < len(lines.frequency) // 2
        ):
            band = lines.around(pole, int(1.5 * len(band.frequency)))
        self.band, f = band, band.frequency
        reach = f[-1] - f[0]
        self.neighbours = tuple(
            other for other in neighbours if f[0] - 0.5 * reach < other.frequency < f[-1] + 0.5 * reach
        )
        self.free = tuple(other for other in self.neighbours if f[0] < other.frequency < f[-1])
        self.held = tuple(other for other in self.neighbours if other not in self.free)
        self.pole = pole
        place = (f - pole.frequency) / max(reach, 1e-300)
        self.powers = place[:, None] ** np.arange(DEGREE + 1)
        self.scale = 2.0 * np.pi * max(pole.frequency * pole.damping, 1.0 / band.duration)
        level = np.sqrt(np.mean(np.abs(band.outputs) ** 2, axis=0))
        self.y = band.outputs / np.where(level > 0.0, level, 1.0)
        push = np.sqrt(np.mean(np.abs(band.inputs) ** 2, axis=0))
        self.u = band.inputs / np.where(push > 0.0, push, 1.0)

    @property
    def determined(self) -> bool:
        """Whether there are lines enough, of the inputs too."""
        columns = len(self.neighbours) + 2 + DEGREE
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
