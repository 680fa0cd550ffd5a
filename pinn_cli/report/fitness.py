"""How well an estimate agrees with the truth (``fitness.csv``), and what it leaves of every sensor (``residuals.csv``).

Fitness. The paper (section 'Case Studies', equation 'Fitness') prints 100 (1 - |x - x~| / |x - mean x|). Its tables
were computed by the authors' public code as 100 (1 - RMSE / (max x - min x)). A prediction of zero everywhere scores 0
by the first and about 79 by the second on the paper's signals, so both are always reported, and neither is called by
the other's name.

Whiteness of residuals. The test is Bartlett's (1955; Priestley 1981, section 6.2.6): of N samples of Gaussian white
noise the cumulated periodogram rises as the distribution function of uniform numbers does, so its distance from the
straight line has the distribution of Kolmogorov and Smirnov. It looks at all lags at once and has no number of lags to
choose. Residuals of an estimate are never quite white: the estimate has taken in the noise of its own band. With K
effective parameters in N samples the distance is about K / N. So the size of a deviation counts as well as its
probability.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy.special import kolmogorov

from pinn_cli.record.channels import every_channel
from pinn_cli.record.checks import clipped_percent, constant_percent
from pinn_cli.record.record import Record
from pinn_cli.record.response import QUANTITIES, Response
from pinn_cli.record.spectrum import band_share, signal_edges

if TYPE_CHECKING:
    from pinn_cli.training.estimate import Estimate

FORMULAS = ("fitness_percent", "range_fitness_percent")
RESIDUAL_COLUMNS = (
    "quantity", "dof", "samples", "signal_rms", "residual_rms", "nmse_percent", "sigma", "residual_over_sigma",
    "mean_residual", "whiteness", "largest_autocorrelation", "spectrum_deviation", "band_low_hz", "band_high_hz",
    "band_share_percent", "free_run_nmse_percent", "clipped_percent", "constant_percent", "channel",
)  # fmt: skip
LAGS = 20  # of the autocorrelation
MANY = 2000  # independent shares, from which on the limit of their distribution is right to a hundredth


def fitness_percent(estimate: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """100 (1 - |x - x~| / |x - mean x|) of every DOF, (dof,), the formula printed in the paper; see `both_formulas`."""
    return both_formulas(estimate, truth)[0]


def both_formulas(estimate: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """The paper's printed formula, and 100 (1 - RMSE / (max x - min x)), that behind its tables: (2, dof), %.

    Use the second only to compare with published numbers: it flatters, since the root mean square of a random signal is
    a small part of its range. 100 is perfect; by the first, 0 is no better than the mean, below 0 is worse. NaN where
    the truth is constant or unknown, or where the estimate is NaN at a known sample.

    Args:
        estimate: x~, (time, dof).
        truth: x, (time, dof); samples that are NaN are unknown and are left out of every sum.
    """
    known = np.isfinite(truth)
    residual = np.where(known, estimate - truth, 0.0)
    samples = np.maximum(known.sum(axis=0), 1)
    mean = np.where(known, truth, 0.0).sum(axis=0) / samples
    deviation = np.where(known, truth - mean, 0.0)
    rmse = np.sqrt((residual**2).sum(axis=0) / samples)
    span = np.max(truth, axis=0, initial=-np.inf, where=known) - np.min(truth, axis=0, initial=np.inf, where=known)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.linalg.norm(residual, axis=0) / np.linalg.norm(deviation, axis=0)
        return np.where(span > 0.0, 100.0 * (1.0 - np.stack([ratio, rmse / span])), np.nan)


def fitness_table(estimate: Response, truth: Response, observed: np.ndarray) -> pd.DataFrame:
    """Both fitness formulas for every group of DOFs and every quantity, one row each (the content of ``fitness.csv``).

    The groups are ``all``, ``first``, ``last``, ``observed``, ``unobserved`` and ``dof_1`` to ``dof_n``. Both formulas
    are evaluated DOF by DOF and then averaged over those DOFs of the group whose cell is not empty. A cell is empty
    (NaN) where the truth is constant (the force of an unforced DOF) or unknown, where the estimator gives no such
    quantity (its column is all NaN), and in a group without DOFs. ``observed`` (dof,) are those with a response sensor.

    Raises:
        ValueError: An estimated column is finite in one place and not in another: an average over what is left would
            hide it.
    """
    for quantity in QUANTITIES:
        estimated = np.isfinite(getattr(estimate, quantity))
        partly = np.flatnonzero(estimated.any(axis=0) & ~estimated.all(axis=0))
        if partly.size:
            raise ValueError(f"the estimated {quantity} of DOF {partly[0] + 1} is not finite at every time")
    scores = {name: both_formulas(getattr(estimate, name), getattr(truth, name)) for name in QUANTITIES}
    return fitness_rows(scores, observed)


def fitness_rows(scores: Mapping[str, np.ndarray], observed: np.ndarray) -> pd.DataFrame:
    """The same from both formulas of every DOF, (2, dof), for every quantity."""
    rows = []
    for group, members in groups(observed).items():
        for quantity in QUANTITIES:
            values = scores[quantity][:, members]
            filled = np.isfinite(values)
            counts, sums = filled.sum(axis=1), np.where(filled, values, 0.0).sum(axis=1)
            rows.append((group, quantity, *np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)))
    return pd.DataFrame(rows, columns=["group", "quantity", *FORMULAS])


def groups(observed: np.ndarray) -> dict[str, np.ndarray]:
    """The groups of DOFs that a table reports, in its order, each as a mask (dof,)."""
    dofs, seen = np.arange(1, len(observed) + 1), np.asarray(observed, dtype=bool)
    named = {"all": dofs > 0, "first": dofs == 1, "last": dofs == len(dofs), "observed": seen, "unobserved": ~seen}
    return named | {f"dof_{dof}": dofs == dof for dof in dofs}


def nmse_percent(residual: np.ndarray, signal: np.ndarray) -> float:
    """100 mean(r^2) / variance of a signal (N,) of which r (N,) is left: 0 is perfect, 100 predicts nothing.

    NaN of a constant signal.
    """
    variance = float(np.var(signal))
    return 100.0 * float(np.mean(residual**2)) / variance if variance > 0.0 else np.nan


def residual_table(estimate: Estimate, record: Record, free_run: Response | None = None) -> pd.DataFrame:
    """One row per sensor (the content of ``residuals.csv``): `RESIDUAL_COLUMNS`; what is not known is empty (NaN).

    ``dof`` is counted from 1, 0 is the ground, and a sensor that feels something else has none; ``channel`` is what
    messages call it. In the unit of the quantity: ``signal_rms`` (about the mean), ``residual_rms`` and
    ``mean_residual`` of r = measured - estimated, ``sigma`` (noise found). In per cent: ``nmse_percent`` (see
    `nmse_percent`), ``free_run_nmse_percent`` (the same of the free run, where there is one; force and ground have
    none, being given), ``band_share_percent`` (of the signal's power, between ``band_low_hz`` and ``band_high_hz``,
    where the signal stands out of its noise), ``clipped_percent`` and ``constant_percent`` (see there). Of r about its
    mean: ``whiteness`` (the probability that white noise would look less white; near 0, r is not white),
    ``spectrum_deviation`` (the distance that this judges), ``largest_autocorrelation`` (with its sign, within `LAGS`
    lags; white noise stays within about 3 / sqrt(samples)).
    """
    rows = []
    for channel in every_channel(record):
        signal, dof = channel.measured, channel.dof + 1 if channel.is_column else None
        residual = signal - channel.of(estimate.response)
        errors, sampled, sigma = residual[channel.there], signal[channel.there], estimate.noise.of(channel)
        rms, largest = float(np.sqrt(np.mean(errors**2))), max(autocorrelation(residual, LAGS), key=abs)
        low, high = signal_edges(signal, record.step)
        free = np.nan
        if free_run is not None and not channel.is_input:
            free = nmse_percent(signal - channel.of(free_run), signal)
        rows.append(
            (
                channel.quantity, dof, len(errors), float(np.std(sampled)), rms, nmse_percent(errors, sampled),
                sigma, rms / sigma if sigma > 0.0 else np.nan, float(np.mean(errors)), white_probability(residual),
                float(largest), cumulated_deviation(residual), low, high,
                100.0 * band_share(signal, record.step, low, high), free, clipped_percent(signal),
                constant_percent(signal), channel.name,
            )
        )  # fmt: skip
    return pd.DataFrame(rows, columns=list(RESIDUAL_COLUMNS)).astype({"dof": "Int64"})


def autocorrelation(values: np.ndarray, lags: int) -> np.ndarray:
    """(lags,) autocorrelation of values (N,) about their mean at lags 1 to ``lags``; NaN where they are constant.

    Divided by N at every lag, so that it dies out with the overlap; beyond N - 1 it is 0.
    """
    centred = values - values.mean()
    power = float(centred @ centred)
    if not power > 0.0:
        return np.full(lags, np.nan)
    return np.array([centred[lag:] @ centred[: max(len(centred) - lag, 0)] / power for lag in range(1, lags + 1)])


def cumulated_periodogram(values: np.ndarray) -> np.ndarray:
    """(m,) share of the power of values (N,) up to each frequency j / N, j = 1 to m, below Nyquist's; NaN of none."""
    power = np.abs(np.fft.rfft(values - values.mean())[1 : (len(values) + 1) // 2]) ** 2
    total = power.sum()
    return np.cumsum(power) / total if total > 0.0 else np.full(len(power), np.nan)


def cumulated_deviation(values: np.ndarray) -> float:
    """Largest distance of the cumulated periodogram of values (N,) from white noise's straight line, 0 to 1."""
    shares = cumulated_periodogram(values)[:-1]
    rank = np.arange(len(shares) + 1) / len(shares)
    return float(np.max(np.maximum(rank[1:] - shares, shares - rank[:-1])))


def white_probability(values: np.ndarray) -> float:
    """The probability that white noise of as many samples deviates further than values (N,) do; NaN where constant."""
    deviation = cumulated_deviation(values)
    shares = (len(values) + 1) // 2 - 2
    return exceeded(deviation, shares) if np.isfinite(deviation) else np.nan


def exceeded(deviation: float, shares: int) -> float:
    """The chance that so many independent shares deviate further: Kolmogorov's, two-sided.

    From `MANY` on it is the limit with a correction of order 1/n (J. Vrbik, Small-sample corrections to
    Kolmogorov-Smirnov test statistic, Pioneer Journal of Theoretical and Applied Statistics 15, 2018): within 1 % of
    the exact one down to chances of 1e-5.
    """
    if shares >= MANY:
        scaled = np.sqrt(shares) * deviation
        return float(kolmogorov(scaled + 1.0 / (6.0 * np.sqrt(shares)) + (scaled - 1.0) / (4.0 * shares)))
    from scipy.stats import kstwo  # not above: it takes longer to import than many a training

    return float(kstwo.sf(deviation, shares))


def published(table: str) -> pd.DataFrame:
    """The values that the paper published, as data.

    ``fitness``: ``table, case, ndof, nonlinearity, model_error, snr_db, group, quantity, fitness_percent``. The last
    column is called as in the paper; its numbers are of the formula 100 (1 - RMSE / range), so compare them with
    ``range_fitness_percent``. ``parameters``: ``table, case, parameter, true, estimate, error_percent, std`` (if
    given). ``perturbed_parameters``, of the sparse-recovery case with wrong values: ``table, case, parameter,
    prescribed, true``.
    """
    with (resources.files("pinn_cli.report") / "published" / f"{table}.csv").open(encoding="utf-8") as file:
        return pd.read_csv(file)


def published_fitness_of(labels: Mapping[str, object]) -> pd.DataFrame:
    """The published fitness of a run's case; none once a setting that makes it that case was changed."""
    values, same = published("fitness"), ["case", "ndof", "nonlinearity", "model_error", "snr_db"]
    return values[(values[same] == [labels[name] for name in same]).all(axis=1)]
