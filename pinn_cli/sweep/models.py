"""A sweep over models of one record: which of them the record makes probable, as a table, a text and a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from pinn_cli.report.figures import style
from pinn_cli.runs.reading import read_table
from pinn_cli.runs.resume import read_record
from pinn_cli.runs.writing import write_table
from pinn_cli.sweep.jobs import FINISHED, Job, Sweep

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.axes import Axes

MODELS = "models.csv"
COLUMNS = (
    "log_evidence", "log_bayes_factor", "probability", "validation_nmse_percent", "effective_parameters", "unknown",
    "verdict",
)  # fmt: skip
# Swept settings that make another model of the same record.
_OF_MODELS = ("system", "scheme.unknown")
# Behind the best by this much or more a model is out of the question (150 to 1; Kass and Raftery 1995).
DECISIVE = 5.0
_LEAST, _ROW = 0.1, 0.22  # nats, as the least bar is drawn; inch
_NONE = 1e-99  # a probability below this is written as zero


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
    return read_table(file) if file.is_file() else None


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


def write_models(models: Comparison, directory: Path) -> None:
    """Write the table and the figure; where models are not compared, those of an earlier look go."""
    figure = models_figure(models)
    if models.table is None or figure is None:
        (directory / MODELS).unlink(missing_ok=True)
        return
    write_table(models.table, directory / MODELS)
    style.save(figure, directory / "figures", "models")


def models_figure(comparison: Comparison) -> Figure | None:
    """A bar for each model; None where they are not compared.

    Left: the logarithm of the Bayes factor against the most probable model of the same other settings, on a logarithmic
    axis; the shaded part is open. Right: the normalised mean square error of the free run, where there is validation
    data.
    """
    table = comparison.table
    if table is None:
        return None
    validated = bool(table["validation_nmse_percent"].notna().any())
    with style.look():
        height = 0.75 + _ROW * len(table)
        figure = Figure(figsize=(style.PAGE_WIDTH if validated else 4.6, height))
        panels = figure.subplots(1, 1 + validated, squeeze=False, sharey=True, gridspec_kw={
            "left": 0.24 if validated else 0.36, "right": 0.98, "top": 1.0 - 0.12 / height, "bottom": 0.48 / height,
            "wspace": 0.08,
        })[0]  # fmt: skip
        place = np.arange(len(table))[::-1]
        _draw_evidence(panels[0], table, place)
        panels[0].set_yticks(place, [_label(row, comparison) for _, row in table.iterrows()])
        if validated:
            error = table["validation_nmse_percent"].to_numpy()
            panels[1].barh(place, error, color=style.GREY, height=0.6)
            panels[1].set_xscale("log")
            panels[1].set_xlabel("free run on validation data, NMSE (%)")
    return figure


def _draw_evidence(axes: Axes, table: pd.DataFrame, place: np.ndarray) -> None:
    behind = -table["log_bayes_factor"].to_numpy()
    axes.axvspan(_LEAST, DECISIVE, color=style.SKY, alpha=0.25, linewidth=0)
    axes.barh(place, np.maximum(behind, _LEAST) - _LEAST, left=_LEAST, color=style.BLUE, height=0.6)
    axes.set_xscale("log")
    axes.set_xlim(_LEAST, max(20.0 * behind.max(), 10.0 * DECISIVE))
    for y, end, probability in zip(place, np.maximum(behind, _LEAST), table["probability"], strict=True):
        shown = f"p = {probability:.2g}" if probability > _NONE else "p = 0"
        axes.annotate(shown, (end, y), xytext=(3, 0), textcoords="offset points", va="center",
                      fontsize=6.5, color=style.BLACK)  # fmt: skip
    axes.set_xlabel("behind the most probable model (nats), and probability p")


def _label(row: pd.Series, comparison: Comparison) -> str:
    others = [name for name in row.index[: list(row.index).index("log_evidence")] if name not in comparison.settings]
    shown = [*comparison.settings, *others]
    values = [str(row[name]) for name in shown if name in row and row[name] == row[name]]
    return style.literal(", ".join(values))
