"""Fitness against how nonlinear the chain is, with and without model error: a question that the paper leaves open."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from pinn_cli.paper.realisations import PINN, Realisation, ScoredRealisations
from pinn_cli.paper.runs import BESIDE, SMOOTHER
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.report.figures import style
from pinn_cli.runs.writing import write_table

# N/m^3 and N; 100 N/m^3 and 1 N are the defaults of the chain and of the force.
KAPPAS = (0.0, 10.0, 100.0, 1000.0, 10000.0)
FORCES = (0.3, 1.0, 3.0, 10.0)
MODEL_ERRORS = ("none", "linear", "perturbed")
# Of force and noise together: one draw of the force may happen to dwell at one amplitude.
SEEDS = 2
KEYS = ["model_error", "kappa", "force_rms", "estimator", "quantity"]

_TITLES = {"none": "right model", "linear": "linear model", "perturbed": "wrong values"}
_SMALLEST, _LARGEST = 0.03, 100.0  # errors in percent, the ends of the colours
_DARK = 3.0  # errors from here up stand on a dark ground


def nonlinearity_realisations() -> list[Realisation]:
    """Six DOFs, 50 dB, defaults but for kappa, the force's root mean square and the model error."""
    return [
        Realisation(
            f"{model_error}_kappa{kappa:g}_force{force:g}_seed{seed}",
            (f"system.kappa={kappa}", f"excitation.rms={force}", f"model_error={model_error}", *BESIDE),
            seed, redraws_force=True, columns=(("kappa", kappa), ("force_rms", force)),
        )
        for seed in range(SEEDS)
        for model_error in MODEL_ERRORS
        for kappa in KAPPAS
        for force in FORCES
    ]  # fmt: skip


@dataclass(frozen=True, eq=False)
class NonlinearityScores:
    """Fitness over the grid.

    Attributes:
        scored: The realisations.
        rows: One per realisation, estimator and quantity, over all DOFs (``nonlinearity_by_seed.csv``).
        summary: Mean over the seeds, one row per `KEYS`, with the mean ``strength``, the worst fitness and the number
            of ``seeds`` that there are (``nonlinearity.csv``).
    """

    scored: ScoredRealisations
    rows: pd.DataFrame
    summary: pd.DataFrame

    @classmethod
    def of(cls, scored: ScoredRealisations) -> NonlinearityScores:
        """Tables of the scores that are there."""
        rows = scored.rows("fitness")
        if rows.empty:
            return cls(scored, rows, rows)
        rows = rows[(rows["group"] == "all") & rows["quantity"].isin(RESPONSE_QUANTITIES)].reset_index(drop=True)
        grouped = rows.groupby(KEYS, sort=False)
        summary = grouped[["strength", "fitness_percent", "range_fitness_percent"]].mean()
        summary["worst_fitness_percent"] = grouped["fitness_percent"].min()
        summary.insert(1, "seeds", grouped["seed"].nunique())
        return cls(scored, rows, summary.reset_index())

    def write(self, directory: Path) -> Path:
        """Write both tables; the path of the summary."""
        write_table(self.rows, directory / "nonlinearity_by_seed.csv")
        return write_table(self.summary, directory / "nonlinearity.csv")

    def draw(self, directory: Path) -> Path | None:
        """Draw ``nonlinearity.png`` and ``.pdf``; the former's path, None where there is nothing to draw."""
        if self.summary.empty:
            return None
        return style.save(nonlinearity_figure(self.summary), directory, "nonlinearity")[0]


def nonlinearity_figure(summary: pd.DataFrame) -> Figure:
    """Draw the summary of `NonlinearityScores`; cells that it lacks are left empty."""
    positive = summary.loc[summary["strength"] > 0.0, "strength"]
    edge = 0.3 * float(positive.min()) if len(positive) else 1e-6  # where kappa = 0 stands on a logarithmic axis
    models = [name for name in _TITLES if name in set(summary["model_error"])]
    with style.look():
        margins = (0.79, 0.72, 0.37, 3.0)  # inch; the curves stand below
        figure, maps = style.panels(3, len(models), 1.47, margins=margins, gaps=(0.11, 0.19), sharex=True, sharey=True)
        height = figure.get_figheight()
        for column, model in zip(maps.T, models, strict=True):
            of_model = summary[summary["model_error"] == model]
            for axes, quantity in zip(column, RESPONSE_QUANTITIES, strict=True):
                image = _heat_map(axes, of_model[of_model["quantity"] == quantity])
            place = column[0].get_position()
            curves = figure.add_axes((place.x0, 0.5 / height, place.width, 1.85 / height))
            _against_strength(curves, of_model[of_model["quantity"] == "displacement"], edge)
            curves.tick_params(labelleft=model == models[0])
            column[0].set_title(_TITLES[model])
            column[-1].set_xlabel(r"$\kappa$ (N/m$^3$)", labelpad=1)
        for axes, quantity in zip(maps[:, 0], RESPONSE_QUANTITIES, strict=True):
            axes.set_ylabel(f"{quantity} {style.SYMBOLS[quantity]}\nforce rms (N)")
        first = figure.axes[maps.size]
        first.set_ylabel(r"error of $u$, 100 − fitness (%)")
        first.legend(loc="center left", handletextpad=0.2, borderaxespad=0.2)
        first.text(0.98, 100.0, "no better than the mean", transform=first.get_yaxis_transform(), ha="right",
                   va="bottom", fontsize=6, color=style.GREY)  # fmt: skip
        bar: Any = figure.colorbar(image, cax=maps[1, -1].inset_axes((1.06, -0.5, 0.06, 2.0)), extend="both")
        bar.set_label("our error, 100 − fitness (%)")
        bar.outline.set_linewidth(0.4)
        bar.ax.set_yticks([0.1, 1.0, 10.0, 100.0], ["0.1", "1", "10", "100"])
    return figure


def _heat_map(axes: Axes, cells: pd.DataFrame) -> AxesImage:
    """Fitness in percent: rows by force, columns by kappa; ours and below it the smoother's."""
    table = cells.pivot_table(index="force_rms", columns=["estimator", "kappa"], values="fitness_percent")
    kappas = sorted(set(cells["kappa"]))
    ours, smoothed = (
        table.reindex(columns=[(name, kappa) for kappa in kappas]).to_numpy() for name in (PINN, SMOOTHER.name)
    )
    error, norm = np.clip(100.0 - ours, _SMALLEST, _LARGEST), LogNorm(_SMALLEST, _LARGEST)
    image = axes.imshow(
        error, cmap=colormaps["viridis_r"], interpolation="nearest", origin="lower", norm=norm, aspect="auto"
    )
    for (row, column), value in np.ndenumerate(ours):
        if np.isfinite(value):
            ink: style.Look = {"ha": "center", "va": "center", "color": "white" if 100.0 - value > _DARK else "black"}
            axes.text(column, row + 0.12, _percent(value), fontsize=7, **ink)
            axes.text(column, row - 0.27, _percent(float(smoothed[row, column])), fontsize=5, **ink)
    axes.set_xticks(range(len(kappas)), [f"{value:g}" for value in kappas])
    axes.set_yticks(range(len(table)), [f"{value:g}" for value in table.index])
    axes.tick_params(length=0)
    return image


def _percent(value: float) -> str:
    if not np.isfinite(value):
        return "-"
    return f"{value:.2f}" if value > 99.0 else f"{value:.1f}" if value > 0.0 else "< 0"


def _against_strength(axes: Axes, cells: pd.DataFrame, edge: float) -> None:
    ours: dict[str, Any] = {"marker": "o", "ms": 3.4, "mfc": style.BLUE, "mec": style.BLUE}
    smoother: dict[str, Any] = {"marker": "s", "ms": 4.4, "mfc": "none", "mec": style.VERMILLION}
    for estimator, title, look in ((PINN, "ours", ours), (SMOOTHER.name, SMOOTHER.title, smoother)):
        of = cells[cells["estimator"] == estimator]
        place = of["strength"].where(of["strength"] > 0.0, edge)
        axes.plot(place, 100.0 - of["fitness_percent"], linestyle="none", markeredgewidth=0.7, label=title, **look)
    axes.set(xscale="log", yscale="log", xlim=(0.5 * edge, 20.0), ylim=(0.02, 2000.0))
    axes.set_xlabel(r"strength $\kappa\,\langle e^2\rangle/k$")
    axes.axhline(100.0, color=style.GREY, linewidth=0.6, linestyle=":")
    axes.grid(True, which="major")
    axes.set_axisbelow(True)
