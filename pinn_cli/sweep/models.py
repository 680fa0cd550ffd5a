"""A sweep over models of one record: which of them the record makes probable, as a table, a text and a figure."""

from __future__ import annotations

from collections.abc import Sequence
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
    from matplotlib.axes import Axes

MODELS = "models.csv"
MODEL_COLUMNS = (
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
    swept = list(dict.fromkeys(name for job in jobs for name in sweep.columns(job)))
    settings = tuple(name for name in swept if name in _OF_MODELS or name.startswith("system."))
    if not settings or sweep.is_search:
        return None
    rows = [sweep.columns(job) | _model_row(job.directory) for job in jobs if job.status == FINISHED]
    models = pd.DataFrame(rows, columns=[*swept, "observed", *MODEL_COLUMNS])
    others = [name for name in swept if name not in settings]
    groups = [group for _, group in models.groupby(others, sort=False, dropna=False)] if others else [models]
    tables = []
    for group in groups:
        if len(group) < 2:
            continue
        reason = _incomparable(group, settings)
        if reason:
            return Comparison(settings, None, reason)
        factor = group["log_evidence"] - group["log_evidence"].max()
        odds = np.exp(factor)
        table = group.assign(log_bayes_factor=factor, probability=odds / odds.sum()).drop(columns="observed")
        tables.append(table.sort_values("log_evidence", ascending=False, kind="stable"))
    if not tables:
        return Comparison(settings, None, "fewer than two of them have finished")
    return Comparison(settings, pd.concat(tables, ignore_index=True))


def _model_row(directory: Path) -> dict[str, Any]:
    """What is compared, of a finished job; the parameters are those of its tables."""
    record = read_record(directory)
    evidence = record.get("training", {}).get("model_log_evidence")
    identifiability, parameters, validation = (
        read_table(directory / name) if (directory / name).is_file() else None
        for name in ("identifiability.csv", "parameters.csv", "validation.csv")
    )
    effective, unknown = np.nan, 0
    if identifiability is not None:
        effective = float((1.0 - (identifiability["std"] / identifiability["prior_std"]).clip(upper=1.0) ** 2).sum())
        if parameters is not None:
            unknown = int(parameters[parameters["estimator"] == "pinn"]["start"].notna().sum())
    return {
        "observed": record.get("observed"),
        "log_evidence": np.nan if evidence is None else float(evidence),
        "validation_nmse_percent": np.nan if validation is None else float(validation["nmse_percent"].mean()),
        "effective_parameters": effective,
        "unknown": unknown,
        "verdict": record.get("verdict"),
    }


def _incomparable(group: pd.DataFrame, settings: Sequence[str]) -> str:
    """Why models cannot be compared; "" where they can."""
    named = [
        " ".join(f"{name}={value}" for name, value in row.items() if value == value)
        for row in group[list(settings)].to_dict("records")
    ]
    for name, evidence, observed in zip(named, group["log_evidence"], group["observed"], strict=True):
        if not np.isfinite(evidence):
            return f"{name} has no evidence: it needs scheme=state_parameter or bayesian, and training=gauss_newton"
        if observed is None or observed != group["observed"].iloc[0]:
            return f"{named[0]} and {name} saw different records or sensors"
    return ""


def models_text(comparison: Comparison) -> str:
    """The table as the sweep prints it, or in one line why there is none."""
    if comparison.table is None:
        return f"models are not compared: {comparison.reason}"
    table = comparison.table
    shown = table[[name for name in table.columns if name not in MODEL_COLUMNS]].copy()
    for name, title, form in (
        ("log_evidence", "log evidence", "{:.1f}"),
        ("probability", "probability", "{:.3f}"),
        ("validation_nmse_percent", "validation NMSE (%)", "{:.3g}"),
        ("effective_parameters", "effective parameters", "{:.1f}"),
    ):
        if name != "validation_nmse_percent" or table[name].notna().any():
            shown[title] = table[name].map(form.format)
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
        size = (style.PAGE_WIDTH if validated else 4.6, 0.75 + _ROW * len(table))
        figure = Figure(figsize=size, layout="constrained")
        panels = figure.subplots(1, 1 + validated, squeeze=False, sharey=True)[0]
        place = np.arange(len(table))[::-1]
        _draw_evidence(panels[0], table, place)
        panels[0].set_yticks(place, [_label(row, comparison) for _, row in table.iterrows()])
        if validated:
            panels[1].barh(place, table["validation_nmse_percent"], color=style.GREY, height=0.6)
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
