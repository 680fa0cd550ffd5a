"""A sweep over models of one record: which of them the record makes probable (``models.csv``)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from pinn_cli.runs.resume import read_record
from pinn_cli.sweep.jobs import FINISHED, Job, Sweep

if TYPE_CHECKING:
    from collections.abc import Iterator

MODELS = "models.csv"
COLUMNS = (
    "log_evidence", "log_bayes_factor", "probability", "validation_nmse_percent", "effective_parameters", "unknown",
    "verdict",
)  # fmt: skip
# Swept settings that make another model of the same record.
_OF_MODELS = ("system", "scheme.unknown")


@dataclass(frozen=True, eq=False)
class Comparison:
    """The models of a sweep.

    Attributes:
        settings: That tell the models apart.
        table: See :func:`compared`; None where they cannot be compared.
        reason: Why not; "" where they are.
    """

    settings: tuple[str, ...]
    table: pd.DataFrame | None
    reason: str = ""


def compared(sweep: Sweep, jobs: Sequence[Job]) -> Comparison | None:
    """Compare the models that the jobs of a sweep differ in; None where they differ in no model.

    Returns:
        A row for each finished job, the most probable first: its swept settings, ``log_evidence`` (natural logarithm of
        the density of all sensors' samples), ``log_bayes_factor`` (that less the greatest), ``probability`` (all models
        being as probable beforehand), ``validation_nmse_percent`` (the free run on ``data.validation``, mean over the
        sensors; empty without), ``effective_parameters`` (how many the record determines beyond their priors) of so
        many ``unknown`` and believed ones, and ``verdict``. Jobs that differ in other settings too are compared with
        those that share these.
    """
    columns = [sweep.columns(job) for job in jobs]
    swept = list(dict.fromkeys(name for each in columns for name in each))
    settings = tuple(name for name in swept if name in _OF_MODELS or name.startswith("system."))
    if not settings or sweep.is_search:
        return None
    found = [(job, own) for job, own in zip(jobs, columns, strict=True) if job.status == FINISHED]
    others = [name for name in swept if name not in settings]
    tables = []
    for group in _groups(found, others):
        if len(group) < 2:
            continue
        rows = [_row(job, own) for job, own in group]
        reason = _incomparable(rows, settings)
        if reason:
            return Comparison(settings, None, reason)
        tables.append(_with_probabilities(rows, swept))
    if not tables:
        return Comparison(settings, None, "fewer than two of them have finished")
    return Comparison(settings, pd.concat(tables, ignore_index=True))


def _groups(
    found: Sequence[tuple[Job, Mapping[str, str]]], others: Sequence[str]
) -> Iterator[list[tuple[Job, Mapping[str, str]]]]:
    """Jobs that differ in their model alone."""
    groups: dict[tuple[str | None, ...], list[tuple[Job, Mapping[str, str]]]] = {}
    for job, own in found:
        groups.setdefault(tuple(own.get(name) for name in others), []).append((job, own))
    yield from groups.values()


def _row(job: Job, swept: Mapping[str, str]) -> dict[str, Any]:
    record = read_record(job.directory)
    evidence = record.get("training", {}).get("model_log_evidence")
    effective, unknown = _parameters(job.directory)
    return {
        **swept,
        "observed": record.get("observed"),
        "log_evidence": np.nan if evidence is None else float(evidence),
        "validation_nmse_percent": _validation(job.directory),
        "effective_parameters": effective,
        "unknown": unknown,
        "verdict": record.get("verdict"),
    }


def _incomparable(rows: Sequence[Mapping[str, Any]], settings: Sequence[str]) -> str:
    """Why models cannot be compared; "" where they can."""
    first = rows[0]
    for row in rows:
        named = _named(row, settings)
        if not np.isfinite(row["log_evidence"]):
            return f"{named} has no evidence: it needs scheme=state_parameter or bayesian, and training=gauss_newton"
        if row["observed"] is None or row["observed"] != first["observed"]:
            return f"{_named(first, settings)} and {named} saw different records or sensors"
    return ""


def _named(row: Mapping[str, Any], settings: Sequence[str]) -> str:
    return " ".join(f"{name}={row[name]}" for name in settings if name in row)


def _with_probabilities(rows: Sequence[Mapping[str, Any]], swept: Sequence[str]) -> pd.DataFrame:
    table = pd.DataFrame(rows).drop(columns="observed")
    factor = table["log_evidence"] - table["log_evidence"].max()
    odds = np.exp(factor)
    table = table.assign(log_bayes_factor=factor, probability=odds / odds.sum())
    columns = [*(name for name in swept if name in table), *COLUMNS]
    return table[columns].sort_values("log_evidence", ascending=False, kind="stable")


def _parameters(directory: Path) -> tuple[float, int]:
    """How many parameters the record determines, and how many were unknown."""
    table = _read(directory / "identifiability.csv")
    if table is None:
        return np.nan, 0
    left = (table["std"] / table["prior_std"]).clip(upper=1.0)
    parameters = _read(directory / "parameters.csv")
    unknown = 0 if parameters is None else int(parameters[parameters["estimator"] == "pinn"]["start"].notna().sum())
    return float((1.0 - left**2).sum()), unknown


def _validation(directory: Path) -> float:
    table = _read(directory / "validation.csv")
    return np.nan if table is None else float(table["nmse_percent"].mean())


def _read(file: Path) -> pd.DataFrame | None:
    return pd.read_csv(file) if file.is_file() else None


def models_text(comparison: Comparison) -> str:
    """The table as the sweep prints it, or in one line why there is none."""
    if comparison.table is None:
        return f"models are not compared: {comparison.reason}"
    table = comparison.table
    shown = pd.DataFrame({name: table[name] for name in table.columns if name not in COLUMNS})
    shown["log evidence"] = table["log_evidence"].map("{:.1f}".format)
    shown["probability"] = table["probability"].map("{:.3f}".format)
    if table["validation_nmse_percent"].notna().any():
        shown["validation NMSE (%)"] = table["validation_nmse_percent"].map("{:.3g}".format)
    shown["effective parameters"] = table["effective_parameters"].map("{:.1f}".format)
    shown["verdict"] = table["verdict"].fillna("-")
    return "\n".join(["models by their evidence; all are as probable beforehand", shown.to_string(index=False)])
