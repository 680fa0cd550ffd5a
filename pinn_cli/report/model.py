"""What a run leaves for later ones: everything that is known of the structure, and no truth."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from pinn_cli.model.file import write_model
from pinn_cli.model.knowledge import Levels, Model, ParameterKnowledge
from pinn_cli.record.response import GROUND, QUANTITIES
from pinn_cli.report.results import Results
from pinn_cli.system.quantities import CALIBRATION_UNITS
from pinn_cli.training.estimate import Estimate
from pinn_cli.training.estimated_structure import estimated_structure
from pinn_cli.training.record_scales import force_and_velocity_scale
from pinn_cli.verdict.finding import Verdict

_log = logging.getLogger(__name__)


def model_of(results: Results, verdict: Verdict | None) -> Model:
    """The identified structure of a run, whose estimate has the parameters of its posterior."""
    estimate = results.estimate
    every = [found.parameter for found in estimate.parameters]
    own = np.array([i for i, p in enumerate(every) if p.kind not in CALIBRATION_UNITS], dtype=int)
    draws = None if results.posterior is None else results.posterior.samples.pooled
    known = _sampled(estimate, draws) if draws is not None else estimate.known or _of_intervals(estimate)
    reasons = verdict.reasons if verdict else ()
    return Model(
        estimated_structure(results.prescribed, estimate.parameters),
        tuple(every[i] for i in own),
        known.of(own),
        _levels(results),
        None if estimate.end is None else replace(estimate.end, with_parameters=estimate.end.with_parameters[:, own]),
        verdict.word if verdict else "",
        next((finding.text for finding in reasons), ""),
        None if draws is None else draws[:, own],
        misfit=estimate.misfit,
    )


def write_run_model(results: Results, verdict: Verdict | None, directory: Path) -> None:
    """Write ``model.npz``, unless a law that somebody added has settings that are no plain values."""
    try:
        write_model(model_of(results, verdict), directory)
    except TypeError as error:
        _log.warning("model.npz is not written: a law of the structure cannot be stored (%s)", error)


def _sampled(estimate: Estimate, draws: np.ndarray) -> ParameterKnowledge:
    """From draws of the posterior (D, p)."""
    nothing, prior = np.zeros(draws.shape[1]), np.array([p.prior_std for p in estimate.parameters])
    covariance = np.atleast_2d(np.cov(draws, rowvar=False))
    return ParameterKnowledge(draws.mean(axis=0), covariance, nothing, nothing, prior)


def _of_intervals(estimate: Estimate) -> ParameterKnowledge:
    """From standard deviations and correlation; the covariance is NaN where a training gives none."""
    found, nothing = estimate.parameters, np.zeros(len(estimate.parameters))
    mean, std, prior = (np.array([getattr(p, name) for p in found]) for name in ("estimate", "std", "prior_std"))
    correlation = estimate.correlation
    if correlation is None:
        correlation = np.where(np.eye(len(found)) > 0, 1.0, 0.0 if len(found) == 1 else np.nan)
    return ParameterKnowledge(mean, correlation * np.outer(std, std), nothing, nothing, prior)


def _levels(results: Results) -> Levels:
    summary, record, sensors = results.estimate.summary, results.record, {}
    supports = [(quantity, len(record.support_names)) for quantity in record.supports]
    for quantity, channels in (*((quantity, record.ndof) for quantity in QUANTITIES), (GROUND, 1), *supports):
        found = summary.get(f"sigma_{quantity}")
        if isinstance(found, list) and len(found) == channels:
            sensors[quantity] = np.array([np.nan if sigma is None else sigma for sigma in found], dtype=float)
    force = np.nan if results.problem is None else force_and_velocity_scale(results.problem)[0]
    told = (summary.get(name) for name in ("sigma_discrepancy", "features_per_dof"))
    discrepancy, features = (np.nan if found is None else float(found) for found in told)
    return Levels(sensors, discrepancy, record.step, float(force), features / record.duration)
