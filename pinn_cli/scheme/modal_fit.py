"""Modes in a band by maximum likelihood: frequencies and damping ratios, with all that is linear in them solved for.

A sensor's spectrum under a force U is, with s = i omega and D_r = s^2 + 2 zeta_r omega_r s + omega_r^2,

    Y = s^d [sum_r A_r / D_r + B / D_below + C / D_above] U + sum_r (x_r + v_r s) / D_r + c_0 + ... + c_3 s^3 + noise

with d = 0, 1, 2 of displacement, velocity, acceleration. A_r are residues, phi_r(sensor) phi_r(force) / modal mass. One
mode far below the band and one far above stand for all that lie there: a mass line and a stiffness line. The rest is
what the motion before the first sample and after the last one leaks into the spectrum (Pintelon and Schoukens, System
Identification, 2012, section 6.3). Noise is white in the sensors and in the force.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares, minimize
from scipy.special import chdtrc

from pinn_cli.record.channels import FINEST_KNOWN
from pinn_cli.record.record import Record
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.system.frequency_response import real_rows

# Of the filter, at lines that are used: further out, noise that leaks there from the band is larger than their own.
LEAST_FILTER_GAIN = 0.7
# Damping ratios that a mode may have.
LEAST_RATIO, LARGEST_RATIO = 1e-4, 0.3
# Modes outside the band reach so far beyond its edges: further ones are the mass line and the stiffness line.
BEYOND = 1.5
# The two modes that stand for all further ones: frequencies over the band's edges, and their damping ratio.
MODE_BELOW, MODE_ABOVE, RESIDUAL_RATIO = 0.25, 4.0, 0.01
# Powers of s in the leakage of all that no mode of the model leaks.
LEAKAGE_POWERS = 4
# Part of its width from another mode within which a mode is at the same place.
ONE_PLACE = 0.1
# Rounds of noise levels and modes.
NOISE_ROUNDS = 4
# A mode whose damping ratio is at the limit is none.
NEARLY = 0.98
# Lines of the parts of a band in which a misfit is looked for; one less probable than this is no chance.
LINES_IN_PART, IMPROBABLE_PART = 12, 1e-4
FIT_EVALUATIONS = 60


@dataclass(frozen=True, eq=False)
class BandSpectra:
    """Discrete Fourier transforms of a record, without taper: what that leaks is a term of the model.

    The lines reach into the flanks of the record's filter: a mode that lies there is seen by its own resonance. What
    the filter takes off is put on again.

    Attributes:
        frequency: (B,), Hz, of the lines within the band and its flanks.
        force: (B,), N.
        response: (B, S), of the sensors, each over its rms in the band.
        scale: (S,), those rms, in the sensors' units.
        orders: (S,), 0, 1, 2 of displacement, velocity, acceleration.
        sensors: (S,), quantity and DOF, from 0.
        band: Hz.
        samples: Of the record.
        gain: (B,), of the filter.
    """

    frequency: np.ndarray
    force: np.ndarray
    response: np.ndarray
    scale: np.ndarray
    orders: np.ndarray
    sensors: tuple[tuple[str, int], ...]
    band: tuple[float, float]
    samples: int
    gain: np.ndarray

    @classmethod
    def of(cls, record: Record, driven: int) -> BandSpectra:
        """Of a record with a band, whose one force is measured on the DOF ``driven``, from 0."""
        assert record.band is not None
        sensors = tuple((q, int(dof)) for q in RESPONSE_QUANTITIES for dof in np.flatnonzero(record.sensors(q)))
        columns = [record.force[:, driven], *(getattr(record, q)[:, dof] for q, dof in sensors)]
        frequency = np.fft.rfftfreq(len(record.time), record.step)
        gain = record.band.gain(frequency)
        lines = gain > LEAST_FILTER_GAIN
        spectra = np.fft.rfft(np.stack(columns, axis=1), axis=0)[lines] / gain[lines, None]
        response = spectra[:, 1:]
        scale = np.sqrt(np.mean(np.abs(response) ** 2, axis=0))
        orders = np.array([RESPONSE_QUANTITIES.index(quantity) for quantity, _ in sensors])
        return cls(
            frequency[lines], spectra[:, 0], response / scale, scale, orders, sensors, record.band.edges,
            len(record.time), gain[lines],
        )  # fmt: skip

    @cached_property
    def s(self) -> np.ndarray:
        """(B,), the Laplace variable, rad/s."""
        return 2j * np.pi * self.frequency

    @cached_property
    def driving(self) -> np.ndarray:
        """(B, S), the force as often differentiated as the displacement in what each sensor measures."""
        return self.s[:, None] ** self.orders * self.force[:, None]


@dataclass(frozen=True, eq=False)
class Noise:
    """White noise of the sensors, (S,), over their rms, and of the force; both as standard deviations of a line."""

    sensors: np.ndarray
    force: float

    def roots(self, response: np.ndarray) -> np.ndarray:
        """(B, S, S), inverses of the covariances' Cholesky factors, from frequency responses (B, S)."""
        of_force = self.force * response
        covariance = of_force[:, :, None] * of_force.conj()[:, None, :] + np.diag(self.sensors**2)
        return np.linalg.inv(np.linalg.cholesky(covariance))


@dataclass(frozen=True, eq=False)
class ModalFit:
    """Modes that were found, and how well.

    Attributes:
        spectra: What they were found in.
        frequencies, ratios: (R,), Hz; those outside the band included, ascending.
        residues: (S, R + 2), 1/kg, of every sensor: of the modes, and of those below and above that stand for the rest.
        covariance: (2 R + S R, 2 R + S R), of the frequencies' logarithms, the ratios' and the modes' residues over
            `unit`.
        unit: (S,).
        noise: See :class:`Noise`.
        residuals: (B, S), residuals in units of their standard deviation.
        missed: (B, S), the same over the sensors' rms.
        log_likelihood: Of the sensors' lines.
    """

    spectra: BandSpectra
    frequencies: np.ndarray
    ratios: np.ndarray
    residues: np.ndarray
    covariance: np.ndarray
    noise: Noise
    residuals: np.ndarray
    missed: np.ndarray
    log_likelihood: float

    @property
    def within(self) -> np.ndarray:
        """(R,) bool, the modes in the band."""
        low, high = self.spectra.band
        margin = 1e-6 * (high - low)
        inside: np.ndarray = (self.frequencies > low + margin) & (self.frequencies < high - margin)
        return inside & (self.ratios < NEARLY * LARGEST_RATIO)

    @property
    def x(self) -> np.ndarray:
        """(2 R,), see :class:`BandModel`."""
        return np.log(np.concatenate((2.0 * np.pi * self.frequencies, self.ratios)))

    @property
    def every_mode(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies, rad/s, and damping ratios (R + 2,), of the modes and of those that stand for the rest."""
        return _with_residual(2.0 * np.pi * self.frequencies, self.ratios, self.spectra.band)

    @property
    def is_distinct(self) -> bool:
        """Whether no two modes outside the band are at one place, where residues without end cancel each other."""
        outside, widths = self.frequencies[~self.within], (self.ratios * self.frequencies)[~self.within]
        distances = np.abs(np.subtract.outer(outside, outside)) + np.abs(np.subtract.outer(widths, widths))
        return bool((distances + np.eye(len(widths)) >= ONE_PLACE * np.minimum.outer(widths, widths)).all())

    @property
    def excess(self) -> np.ndarray:
        """(R,), power that is left about each mode over that of the noise, 1 at the least: what the model misses there.

        About a mode are the lines nearest to it, within two widths of its resonance or as many as tell the power.
        """
        power = np.mean(np.abs(self.residuals) ** 2, axis=1)
        away = np.abs(self.spectra.frequency[:, None] - self.frequencies)
        widths = 2.0 * self.ratios * self.frequencies
        near = away <= np.maximum(2.0 * widths, np.sort(away, axis=0)[min(LINES_IN_PART, len(away) - 1)])
        return np.maximum(1.0, (power[:, None] * near).sum(0) / near.sum(0))

    @property
    def misfit(self) -> float:
        """Part of the sensors' power that is left in the part of the band that fits worst, beyond noise; 0: in none."""
        worst, response_power = 0.0, np.abs(self.spectra.response) ** 2
        lines = np.array_split(np.arange(len(self.residuals)), max(1, len(self.residuals) // LINES_IN_PART))
        for part in lines:
            power = np.abs(self.residuals[part]) ** 2
            if chdtrc(2 * power.size, 2.0 * float(power.sum())) * len(lines) < IMPROBABLE_PART:
                worst = max(worst, float(np.sum(np.abs(self.missed[part]) ** 2) / np.sum(response_power[part])))
        return worst

    def response(self, frequency: np.ndarray) -> np.ndarray:
        """(F, S), frequency responses in the sensors' units per newton."""
        s, (omega, zeta) = 2j * np.pi * frequency, self.every_mode
        return s[:, None] ** self.spectra.orders * (self.residues @ (1.0 / _denominators(s, omega, zeta)).T).T


class BandModel:
    """The rows of a record's spectra in a band as a function of frequencies and damping ratios.

    The unknowns x (2 R,) are the logarithms of the frequencies and of the damping ratios.
    """

    def __init__(self, spectra: BandSpectra) -> None:
        self.spectra = spectra
        low, high = spectra.band
        self.centre = np.pi * (low + high)

    def columns(self, x: np.ndarray) -> np.ndarray:
        """(S, B, P), complex, of the real linear unknowns: residues, lines, leakage; near one in size."""
        omega, zeta = np.exp(x.reshape(2, -1))
        s, unit = self.spectra.s, self.centre
        d = _denominators(s, *_with_residual(omega, zeta, self.spectra.band)) / unit**2
        lines, d = 1.0 / d, d[:, : len(omega)]
        powers = (s[:, None] / unit) ** np.arange(LEAKAGE_POWERS)
        leakage = np.hstack((1.0 / d, s[:, None] / unit / d, powers)) / self.spectra.gain[:, None]
        driven = self._driven[:, :, None] * lines
        return np.concatenate((driven, np.broadcast_to(leakage, (len(driven), *leakage.shape))), axis=2)

    def candidates(self, tried: np.ndarray) -> np.ndarray:
        """(S, T, B, 3), the columns of one mode each; candidates (T, 2) as in the unknowns."""
        omega, zeta = np.exp(tried.T)
        s, unit = self.spectra.s, self.centre
        line = (unit**2 / _denominators(s, omega, zeta)).T
        leaked = line / self.spectra.gain
        leakage = np.stack((leaked, leaked * s / unit), axis=2)
        driven = (self._driven[:, None] * line)[..., None]
        return np.concatenate((driven, np.broadcast_to(leakage, (len(driven), *leakage.shape))), axis=3)

    @property
    def _driven(self) -> np.ndarray:
        """(S, B), what drives the displacement in each sensor, over its rms."""
        driving = self.spectra.driving
        return (driving / np.sqrt(np.mean(np.abs(driving) ** 2, axis=0))).T

    @property
    def of_residues(self) -> np.ndarray:
        """(S,), from coefficients of the driven columns to residues, m/N times the square of `centre`."""
        driving = np.sqrt(np.mean(np.abs(self.spectra.driving) ** 2, axis=0))
        return self.spectra.scale / driving

    def slopes(self, x: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        """(S, B, 2 R), of columns times coefficients (S, P), by x."""
        omega, zeta = np.exp(x.reshape(2, -1))
        count, s = len(omega), self.spectra.s
        d = _denominators(s, omega, zeta)
        by_omega = -(2.0 * zeta * omega * s[:, None] + 2.0 * omega**2) / d
        by_zeta = -(2.0 * zeta * omega * s[:, None]) / d
        columns = self.columns(x)
        shares = columns[:, :, : 3 * count + 2] * coefficients[:, None, : 3 * count + 2]
        shares = np.delete(shares, [count, count + 1], axis=2)  # the residual terms do not move
        moved = shares.reshape(*shares.shape[:2], 3, count).sum(2)
        return np.concatenate((moved * by_omega, moved * by_zeta), axis=2)

    def solved(self, x: np.ndarray, roots: np.ndarray) -> Solved:
        """The linear unknowns at x, under weights (B, S, S)."""
        columns = self.columns(x)
        sensors, lines, unknowns = columns.shape
        weighed = np.einsum("bts,sbp->btsp", roots, columns).reshape(lines * sensors, sensors * unknowns)
        target = np.einsum("bts,bs->bt", roots, self.spectra.response).reshape(-1)
        q, r = np.linalg.qr(real_rows(weighed))
        target = real_rows(target)
        coefficients = solve_triangular(r, q.T @ target).reshape(sensors, unknowns)
        return Solved(q, r, coefficients, target - q @ (q.T @ target))

    def slopes_left(self, x: np.ndarray, roots: np.ndarray, solved: Solved) -> tuple[np.ndarray, np.ndarray]:
        """What x does to the residual, linear unknowns following (Kaufman 1975), and to those: (rows, q), (S P, q)."""
        slope = np.einsum("bts,sbq->btq", roots, self.slopes(x, solved.coefficients))
        slope = real_rows(slope.reshape(-1, slope.shape[-1]))
        along = solved.q.T @ slope
        return -(slope - solved.q @ along), -solve_triangular(solved.r, along)


@dataclass(frozen=True, eq=False)
class Solved:
    """Linear unknowns (S, P) by an orthogonal decomposition q r of their rows, and the residual (rows,)."""

    q: np.ndarray
    r: np.ndarray
    coefficients: np.ndarray
    residual: np.ndarray


def fitted(spectra: BandSpectra, x: np.ndarray, noise: Noise | None = None, rounds: int = NOISE_ROUNDS) -> ModalFit:
    """The most probable modes near a start x, see :class:`BandModel`, and noise levels after so many rounds."""
    model = BandModel(spectra)
    response = np.zeros_like(spectra.response)
    noise = noise or Noise(np.ones(spectra.response.shape[1]), 0.0)
    for _ in range(rounds):
        roots = noise.roots(response)
        x = _moved(model, x, roots)
        solved = model.solved(x, roots)
        response = _of_force(model, x, solved.coefficients)
        before, noise = noise, _noise(model, x, solved, response)
        if np.abs(np.log(noise.sensors / before.sensors)).max() < 0.02:
            break
    return _modal_fit(model, x, noise, response)


def _moved(model: BandModel, x: np.ndarray, roots: np.ndarray) -> np.ndarray:
    low, high = model.spectra.band
    count = len(x) // 2
    inside = (np.exp(x[:count]) / (2 * np.pi) >= low) & (np.exp(x[:count]) / (2 * np.pi) <= high)
    above = np.exp(x[:count]) / (2 * np.pi) > high
    least = np.where(inside, low, np.where(above, high, low / BEYOND))
    most = np.where(inside, high, np.where(above, high * BEYOND, low))
    bounds = [
        np.concatenate((np.log(2 * np.pi * edge), np.full(count, np.log(ratio))))
        for edge, ratio in ((least, LEAST_RATIO), (most, LARGEST_RATIO))
    ]
    memo: dict[bytes, Solved] = {}

    def solved(x: np.ndarray) -> Solved:
        key = x.tobytes()
        if key not in memo:
            memo.clear()
            memo[key] = model.solved(x, roots)
        return memo[key]

    start = np.clip(x, bounds[0] + 1e-9, bounds[1] - 1e-9)
    solution = least_squares(
        lambda x: solved(x).residual, start, lambda x: model.slopes_left(x, roots, solved(x))[0],
        bounds=bounds, x_scale=np.concatenate((np.exp(x[count:]), np.ones(count))), max_nfev=FIT_EVALUATIONS, xtol=1e-9,
    )  # fmt: skip
    return np.asarray(solution.x)


def _of_force(model: BandModel, x: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """(B, S), what a unit of the force's rms makes of the scaled sensors."""
    count = len(x) // 2 + 2
    s = model.spectra
    driven = np.einsum("sbp,sp->bs", model.columns(x)[:, :, :count], coefficients[:, :count])
    rms = np.sqrt(np.mean(np.abs(s.force) ** 2))
    return driven / s.force[:, None] * rms


def _missed(model: BandModel, x: np.ndarray, solved: Solved) -> np.ndarray:
    """(B, S), what the model leaves of the scaled responses."""
    return model.spectra.response - np.einsum("sbp,sp->bs", model.columns(x), solved.coefficients)


def _noise(model: BandModel, x: np.ndarray, solved: Solved, response: np.ndarray) -> Noise:
    """The most probable levels for the residuals, those that were fitted counted."""
    lines, sensors = model.spectra.response.shape
    residuals = _missed(model, x, solved)
    count = 2 * lines * sensors
    freedom = max(count - solved.coefficients.size - len(x), 1) / count
    residuals = residuals / np.sqrt(freedom)
    start = np.log(np.append(np.median(np.abs(residuals), axis=0) + FINEST_KNOWN, 1e-3))

    def minus_log(levels: np.ndarray) -> float:
        variance = np.exp(2.0 * levels)
        over = np.abs(response) ** 2 / variance[:-1]  # (B, S)
        whole = 1.0 + variance[-1] * over.sum(1)
        along = np.einsum("bs,bs,s->b", response.conj(), residuals, 1.0 / variance[:-1])
        value = lines * 2.0 * levels[:-1].sum() + np.log(whole).sum()
        square = np.abs(residuals) ** 2 / variance[:-1]
        value += square.sum() - (variance[-1] * np.abs(along) ** 2 / whole).sum()
        return float(value)

    bounds = [(np.log(FINEST_KNOWN), np.log(10.0))] * (sensors + 1)
    optimum = minimize(minus_log, start, method="L-BFGS-B", bounds=bounds)
    return Noise(np.exp(optimum.x[:-1]), float(np.exp(optimum.x[-1])))


def _modal_fit(model: BandModel, x: np.ndarray, noise: Noise, response: np.ndarray) -> ModalFit:
    spectra, count = model.spectra, len(x) // 2
    roots = noise.roots(response)
    solved = model.solved(x, roots)
    lines, sensors = spectra.response.shape
    by_x, linear_by_x = model.slopes_left(x, roots, solved)
    # Real and imaginary part of a line have half its variance each.
    information = 2.0 * by_x.T @ by_x
    of_x = np.linalg.inv(information + 1e-12 * np.diag(np.diag(information)))
    unknowns = solved.coefficients.shape[1]
    chosen = (np.arange(sensors)[:, None] * unknowns + np.arange(count)).reshape(-1)
    root = np.linalg.inv(solved.r)[chosen] / np.sqrt(2.0)
    moved = np.vstack((np.eye(2 * count), linear_by_x[chosen]))
    covariance = moved @ of_x @ moved.T
    covariance[2 * count :, 2 * count :] += root @ root.T
    unit = np.repeat(model.of_residues * model.centre**2, count)
    scale = np.append(np.ones(2 * count), unit)
    residues = solved.coefficients[:, : count + 2] * (model.of_residues * model.centre**2)[:, None]
    residuals = solved.residual[: lines * sensors] + 1j * solved.residual[lines * sensors :]
    residuals = residuals.reshape(lines, sensors)
    log_likelihood = 2.0 * np.log(np.abs(np.einsum("bss->bs", roots))).sum() - np.sum(np.abs(residuals) ** 2)
    order = np.argsort(x[:count])
    places = np.concatenate((order, count + order, *(2 * count + i * count + order for i in range(sensors))))
    covariance = (scale[:, None] * covariance * scale)[np.ix_(places, places)]
    omega, zeta = np.exp(x.reshape(2, -1))[:, order]
    residues = np.hstack((residues[:, order], residues[:, count:]))
    missed = _missed(model, x, solved)
    frequencies = omega / (2.0 * np.pi)
    return ModalFit(spectra, frequencies, zeta, residues, covariance, noise, residuals, missed, float(log_likelihood))


def _with_residual(omega: np.ndarray, zeta: np.ndarray, band: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, rad/s, and ratios with those of the modes that stand for all far outside the band."""
    far = 2.0 * np.pi * np.array([MODE_BELOW * band[0], MODE_ABOVE * band[1]])
    return np.concatenate((omega, far)), np.concatenate((zeta, [RESIDUAL_RATIO] * 2))


def _denominators(s: np.ndarray, omega: np.ndarray, zeta: np.ndarray) -> np.ndarray:
    """(B, R)."""
    return s[:, None] ** 2 + 2.0 * zeta * omega * s[:, None] + omega**2
