"""`pinn-run population`: finished runs of similar structures, gathered, compared, and told in tables and a figure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.ticker import MaxNLocator

from pinn_cli.inspection.report import LookReport
from pinn_cli.model.file import finished_model
from pinn_cli.model.knowledge import Model
from pinn_cli.model.population import FEWEST, Population
from pinn_cli.report.figures import style
from pinn_cli.report.text import Column, marked_lines, number, table_lines
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import located
from pinn_cli.sweep.jobs import STORED, Sweep
from pinn_cli.system.priors import HALF_WIDTH_90

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RUNS_ALLOWED = "directories of finished runs, one for each structure, or of a sweep"
# Of a run's model.npz, what says nothing of the parameters and is left unread.
_UNREAD = ("end_", "misfit_", "draws")
# Standard deviation with the others over that alone from which a structure is told to borrow.
BORROWED = 0.5
LINES_SHOWN, PANELS_SHOWN, PANELS_ACROSS = 5, 12, 2


@dataclass(frozen=True, eq=False, repr=False)
class PopulationReport(LookReport):
    """What :func:`pinn_cli.population` returns; ``print`` shows what the command prints.

    Attributes:
        models: Name of a structure to what its run found.
        left_out: Structures that are not among them, and why.
    """

    models: Mapping[str, Model]
    left_out: Sequence[str]

    @classmethod
    def of(cls, given: Sequence[str], base: Path) -> PopulationReport:
        """Of directories, those that are relative from a folder on.

        Raises:
            InputError: One is no finished run's nor a sweep's, fewer than three runs can be used, or they have no
                parameters in common.
        """
        models, left_out = dict[str, Model](), []
        for name, place, in_sweep in _places(given, base):
            try:
                model = _usable(place)
            except InputError as error:
                if not in_sweep:
                    raise
                left_out.append(f"{name}: {error.hint}")
                continue
            if model.verdict == "failed":
                left_out.append(f"{name}: its verdict is failed: {model.reason}")
            else:
                models[name] = model
        report, shown = cls(models, left_out), ", ".join(given) or "nothing"
        if len(models) < FEWEST:
            hint = f"there are {len(models)} that can be used; {'; '.join(left_out)}".strip("; ")
            raise InputError("population", shown, f"{FEWEST} finished runs or more, or a sweep of such", hint)
        if not report.names:
            hint = "; ".join(f"{n}: {', '.join(p.name for p in m.parameters)}" for n, m in list(models.items())[:2])
            raise InputError("population", shown, "runs with uncertain parameters in common", hint)
        return report

    @cached_property
    def names(self) -> list[str]:
        """Of the parameters that all have, in the order of the first; terms of curves are each run's own."""
        counted = Counter(p.name for model in self.models.values() for p in model.parameters if not p.curve)
        return [name for name, count in counted.items() if count == len(self.models)]

    @cached_property
    def population(self) -> Population:
        """The structures in one hierarchical model."""
        known, lower = [], []
        for model in self.models.values():
            place = {p.name: i for i, p in enumerate(model.parameters)}
            chosen = np.array([place[name] for name in self.names])
            known.append(model.known.of(chosen))
            lower.append(model.lower[chosen])
        return Population(known, np.min(lower, axis=0))

    @cached_property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """``population``, a row for each structure and parameter, and ``population_mean``, one for each parameter."""
        found, (first, *_) = self.population, self.models.values()
        units = {p.name: p.unit for p in first.parameters}
        mean = pd.DataFrame({"parameter": self.names, "unit": [units[name] for name in self.names]})
        for name, part in (("mean", found.mean), ("spread", found.spread)):
            mean[name], mean[f"{name}_std"], mean[f"{name}_lower_90"], mean[f"{name}_upper_90"] = part
        mean["another_lower_90"], mean["another_upper_90"] = found.another[2:]
        structures = pd.DataFrame(
            [(name, str(model.directory), model.verdict, parameter, units[parameter])
             for name, model in self.models.items() for parameter in self.names],
            columns=["structure", "directory", "verdict", "parameter", "unit"],
        )  # fmt: skip
        columns = ("alone", "alone_std", "estimate", "std", "lower_90", "upper_90", "off")
        for name, values in zip(columns, (found.alone, found.alone_std, *found.structures, found.off), strict=True):
            structures[name] = values.ravel()
        structures["outlier"] = found.outlier.ravel()
        return {"population": structures, "population_mean": mean}

    @property
    def structures(self) -> pd.DataFrame:
        """A row for each structure and parameter: ``alone`` by its own record, ``estimate`` with all others'."""
        return self.tables["population"]

    @property
    def mean(self) -> pd.DataFrame:
        """A row for each parameter: mean and spread over the structures, and where another structure is expected."""
        return self.tables["population_mean"]

    @property
    def drawings(self) -> Mapping[str, Callable[[], Figure]]:
        """``population``: every parameter over the structures."""
        return {"population": partial(population_figure, self.structures, self.mean)}

    def text(self) -> str:
        """See :class:`LookReport`."""
        table, rows = self.mean.copy(), self.structures
        for name in ("mean", "spread", "another"):
            ends = zip(table[f"{name}_lower_90"], table[f"{name}_upper_90"], strict=True)
            table[f"{name}_90"] = [f"{number(low, 4)} to {number(high, 4)}" for low, high in ends]
        columns = {
            "parameter": Column("parameter", -12),
            "unit": Column("unit", -8),
            "mean": Column("mean", 10, partial(number, digits=4)),
            "mean_90": Column("90 %", 19),
            "spread": Column("spread", 9, partial(number, digits=3)),
            "spread_90": Column("90 %", 18),
            "another_90": Column("another one, 90 %", 20),
        }
        lines = [f"{len(self.models)} structures; spread: standard deviation of a parameter among them", ""]
        lines += [*table_lines(columns, table), ""]
        doubted = [name for name, model in self.models.items() if model.verdict == "questionable"]
        told = [f"left out: {each}" for each in _few(self.left_out)]
        told += [f"questionable by themselves: {', '.join(_few(doubted))}"] if doubted else []
        outliers = rows.loc[rows["outlier"], ["parameter", "structure", "off"]]
        told += _few([
            f"{parameter} of {name} is {abs(off):.1f} standard deviations {'above' if off > 0.0 else 'below'} what the "
            "others let expect, and counts for none of them: has it changed, or is its run wrong?"
            for parameter, name, off in outliers.to_numpy()
        ])  # fmt: skip
        share = rows["std"] / rows["alone_std"]
        least = share.groupby(rows["structure"]).transform("min")
        borrowing = rows.assign(least=least)[share < BORROWED].sort_values("least", kind="stable")
        told += _few([
            f"{name} borrows from the others: {_borrowed(of_one)}"
            for name, of_one in borrowing.groupby("structure", sort=False)
        ])  # fmt: skip
        return "\n".join([*lines, *(line for each in told for line in marked_lines(each))])


def _places(given: Sequence[str], base: Path) -> Iterator[tuple[str, Path, bool]]:
    """A structure's name, its run's directory, and whether that is a job of a sweep."""
    for each in given:
        place = located(each, base)
        if not (place / STORED).is_file():
            yield each, place, False
            continue
        sweep = Sweep.read(place)
        jobs = sweep.jobs()
        names = [",".join(Path(value).name for value in sweep.columns(job).values()) for job in jobs]
        for job, name in zip(jobs, names, strict=True):
            folder = job.directory.relative_to(place).as_posix()
            yield name if name and names.count(name) == 1 else folder, job.directory, True


def _usable(directory: Path) -> Model:
    """What a run knows of its parameters; one that has not finished, or tells no standard deviations, is refused."""
    try:
        model = finished_model(str(directory), without=_UNREAD)
    except InputError as error:
        raise InputError("population", directory, RUNS_ALLOWED, error.hint) from error
    if not np.isfinite(model.known.covariance).all():
        hint = "its training tells no standard deviations of the parameters: training=gauss_newton does"
        raise InputError("population", directory, RUNS_ALLOWED, hint)
    return model


def _few(texts: Sequence[str]) -> list[str]:
    more = len(texts) - LINES_SHOWN
    return [*texts[:LINES_SHOWN], *([f"and {more} more"] if more > 0 else [])]


def _borrowed(rows: pd.DataFrame) -> str:
    """``k_1 9.2 to 4.7 %``, standard deviations."""
    percent = (100.0 * rows[["alone_std", "std"]].div(rows["estimate"].abs(), axis=0)).to_numpy()
    parts = zip(rows["parameter"], percent, strict=True)
    return ", ".join(f"{name} {number(alone, 2)} to {number(std, 2)} %" for name, (alone, std) in parts)


def population_figure(structures: pd.DataFrame, mean: pd.DataFrame) -> Figure:
    """A panel for each parameter: every structure by itself and with the others, 90 % intervals, and where one lies."""
    shown = mean.head(PANELS_SHOWN)
    with style.look():
        rows = -(-len(shown) // PANELS_ACROSS)
        figure, panels = style.panels(rows, PANELS_ACROSS, 1.3, margins=(0.6, 0.08, 0.45, 0.4), gaps=(0.6, 0.32))
        for axes in panels.flat[len(shown) :]:
            axes.remove()
        for axes, (_, of_mean) in zip(panels.flat, shown.iterrows(), strict=False):
            _draw(axes, structures[structures["parameter"] == of_mean["parameter"]], of_mean)
        for axes in panels[-1]:
            axes.set_xlabel("Structure", labelpad=2)
        style.legend(figure)
        if len(shown) < len(mean):
            style.note(figure, f"the first {len(shown)} of {len(mean)} parameters")
    return figure


def _draw(axes: Axes, rows: pd.DataFrame, mean: pd.Series) -> None:
    factor, prefix = style.unit_prefix(float(rows["estimate"].abs().max()), kilo=True)
    place = np.arange(1, len(rows) + 1)
    names = ["alone", "alone_std", "estimate", "lower_90", "upper_90"]
    alone, alone_std, estimate, lower, upper = factor * rows[names].to_numpy(float).T
    expected = factor * mean[["another_lower_90", "another_upper_90"]].to_numpy(float)
    axes.axhspan(*expected, color=style.SKY, alpha=0.2, linewidth=0, label="another structure, 90 %")
    axes.axhline(factor * mean["mean"], color=style.SKY, linewidth=0.8)
    look: style.Look = {"linestyle": "none", "marker": "o", "markersize": 2.2, "elinewidth": 0.6}
    axes.errorbar(
        place, estimate, np.abs(np.stack((lower, upper)) - estimate), color=style.BLUE, label="with the others", **look
    )
    low, high = min(lower.min(), expected[0]), max(upper.max(), expected[1])
    axes.set_ylim(low - 0.3 * (high - low), high + 0.3 * (high - low))
    axes.errorbar(place + 0.25, alone, HALF_WIDTH_90 * alone_std, color=style.GREY, label="alone", **look)
    out = rows["outlier"].to_numpy(bool)
    if out.any():
        axes.plot(place[out], estimate[out], "s", color=style.VERMILLION, markersize=4, mfc="none", label="outlier")
    axes.xaxis.set_major_locator(MaxNLocator(7, integer=True, min_n_ticks=1))
    unit = str(mean["unit"])
    axes.set_title(f"{mean['parameter']} ({prefix}{style.raised(unit)})" if unit else str(mean["parameter"]), pad=3)
