"""Which modes a band holds: one after the other, each where it explains most of what is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pinn_cli.scheme.modal.modal_fit import BEYOND, BandModel, BandSpectra, ModalFit, fitted
from pinn_cli.system.frequency_response import real_rows

# Damping ratio of a mode whose frequency somebody gave, and those that are tried.
FIRST_RATIO, RATIOS_TRIED = 0.01, (0.005, 0.02)
# From one frequency that is tried to the next, as a part of it: half the width of the sharpest resonance tried.
SPACING = 0.005
# Two close modes may look like one between them: it is split into two that lie so many of its widths apart.
SPLITS = 0.7, 1.4
# Candidates whose columns are held at once.
TRIED_AT_ONCE = 48
# What a mode more explains at the least, in nepers of what is left: no structure is quite linear, and its spectra quite
# those of modes.
LEAST_EXPLAINED = 0.05


def searched(spectra: BandSpectra, count: int | None = None, starts: Sequence[float] = ()) -> ModalFit:
    """The modes of a band, from nothing: one after the other, where it explains most of what is left.

    Modes outside the band are added where the record is more probable with them, by Schwarz's criterion.

    Args:
        spectra: Of the record.
        count: Modes in the band; None: as many as the criterion wants.
        starts: Hz, where the first ones are looked for; empty: wherever they are.
    """
    fit: ModalFit | None = None
    if starts:
        first = np.concatenate((2.0 * np.pi * np.array(starts), np.full(len(starts), FIRST_RATIO)))
        fit = fitted(spectra, np.log(first))
    while True:
        within = 0 if fit is None else int(fit.within.sum())
        lacking = count is not None and within < count
        tried = _starts(spectra, fit, inside=count is None or lacking)
        again = _best(spectra, tried)
        more = int(again.within.sum()) > within and (count is None or lacking)
        if fit is not None and gain(fit, again) <= 0.0 and not (more and lacking):
            return fit
        fit = again


def missing_mode(fit: ModalFit) -> float | None:
    """Frequency, Hz, of a mode more in the band that makes the record more probable; None: there is none."""
    again = _best(fit.spectra, _starts(fit.spectra, fit, inside=True))
    if gain(fit, again) <= 0.0 or again.within.sum() <= fit.within.sum():
        return None
    new = again.frequencies[again.within]
    distance = np.abs(new[:, None] - fit.frequencies[None, fit.within]).min(axis=1)
    return float(new[distance.argmax()])


def _best(spectra: BandSpectra, starts: Sequence[np.ndarray]) -> ModalFit:
    """The most probable one of the modes near several starts."""
    fits = (fitted(spectra, x, rounds=1) for x in starts)
    best = max(fits, key=lambda fit: (fit.is_distinct, fit.log_likelihood))
    return fitted(spectra, best.x, replace(best.noise, force=0.0))


def gain(before: ModalFit, after: ModalFit) -> float:
    """How much more probable a mode more makes the record, its unknowns paid for (Schwarz 1978)."""
    if not after.is_distinct:
        return -np.inf
    lines, sensors = before.residuals.shape
    price = max(0.5 * (2 + 3 * sensors) * np.log(2.0 * lines * sensors), LEAST_EXPLAINED * lines * sensors)
    return after.log_likelihood - before.log_likelihood - price


def _starts(spectra: BandSpectra, fit: ModalFit | None, inside: bool) -> list[np.ndarray]:
    """Unknowns with one mode more: where it explains most of what is left, or the mode nearest to that split in two."""
    x = np.empty(0) if fit is None else fit.x
    new = _candidate(spectra, x, fit, inside)
    starts = [_joined(x, *new)]
    if fit is None or not fit.within.any() or not inside:
        return starts
    within = np.flatnonzero(fit.within)
    nearest = within[np.abs(np.log(2.0 * np.pi * fit.frequencies[within]) - new[0]).argmin()]
    rest = np.delete(x.reshape(2, -1), nearest, axis=1).reshape(-1)
    omega, zeta = x.reshape(2, -1)[:, nearest]
    for widths in SPLITS:
        offset = widths * np.exp(zeta)
        split = _joined(rest, omega - offset, zeta - np.log(2.0))
        starts.append(_joined(split, omega + offset, zeta - np.log(2.0)))
    return starts


def _joined(x: np.ndarray, omega: float, zeta: float) -> np.ndarray:
    """Unknowns with one mode more."""
    return np.column_stack((x.reshape(2, -1), (omega, zeta))).reshape(-1)


def _candidate(spectra: BandSpectra, x: np.ndarray, fit: ModalFit | None, inside: bool) -> tuple[float, float]:
    """Logarithms of the frequency and the damping ratio of the mode that explains most of what x leaves."""
    model = BandModel(spectra)
    weight = np.ones(len(spectra.sensors)) if fit is None else 1.0 / fit.noise.sensors
    low, high = np.log(spectra.band)
    beyond = np.log(BEYOND)
    grid = np.linspace(low - beyond, high + beyond, int((high - low + 2.0 * beyond) / SPACING))
    if not inside:
        grid = grid[(grid < low) | (grid > high)]
    tried = np.array([(f + np.log(2.0 * np.pi), np.log(zeta)) for f in grid for zeta in RATIOS_TRIED])
    basis = [np.linalg.qr(real_rows(columns))[0] for columns in model.columns(x)]
    residuals = [real_rows(y) - q @ (q.T @ real_rows(y)) for y, q in zip(spectra.response.T, basis, strict=True)]
    explained = np.concatenate(
        [
            sum(
                f**2 * _explained(columns, q, y)
                for columns, q, y, f in zip(candidates, basis, residuals, weight, strict=True)
            )
            for candidates in (
                model.candidates(some) for some in np.array_split(tried, -(-len(tried) // TRIED_AT_ONCE))
            )
        ]
    )
    omega, zeta = tried[int(explained.argmax())]
    return float(omega), float(zeta)


def _explained(columns: np.ndarray, basis: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """(T,), squares of what is left (rows,) that each candidate's columns (T, B, 3) explain beside a basis."""
    new = np.concatenate((columns.real, columns.imag), axis=1)
    new = new - basis @ (basis.T @ new)
    new /= np.linalg.norm(new, axis=1, keepdims=True)
    turned = np.ascontiguousarray(new.transpose(0, 2, 1))
    along = turned @ residual
    gram = turned @ new + 1e-10 * np.eye(new.shape[-1])
    explained: np.ndarray = np.einsum("tc,tc->t", along, np.linalg.solve(gram, along[..., None])[..., 0])
    return explained
