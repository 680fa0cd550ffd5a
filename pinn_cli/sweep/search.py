"""`hydra/sweeper=search`: trials, one after the other or side by side, each drawn by Optuna from those before it.

A draw depends on the seed, its number and the trials before its batch, and on nothing that a kill could interrupt. So
nothing is kept of a search but its jobs: the same command draws the same trials once more, finds those that are
finished in their directories, and goes on as if it had never been stopped. It leaves search.csv, search.md, a figure.
"""

from __future__ import annotations

import hashlib
import logging
import math
import re
import shlex
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import optuna
import pandas as pd
from hydra.core.override_parser.types import IntervalSweep, Override, RangeSweep, Transformer
from hydra.core.plugins import Plugins
from hydra.core.utils import JobReturn
from hydra.types import HydraContext, TaskFunction
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from omegaconf import DictConfig, OmegaConf
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.samplers import BaseSampler, RandomSampler, TPESampler
from optuna.trial import FrozenTrial, TrialState, create_trial

from pinn_cli.report.figures import style
from pinn_cli.runs.identity import is_left_out
from pinn_cli.runs.reading import printable
from pinn_cli.runs.resume import read_record
from pinn_cli.runs.writing import replacing, write_table, write_text
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import one_of, whole_number
from pinn_cli.settings.override_syntax import setting_of
from pinn_cli.sweep.composing import parse
from pinn_cli.sweep.jobs import Failure, Sweep
from pinn_cli.sweep.running import begin_sweep, tell

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SEARCH_FILE = "search.db"
TABLE, TEXT, FIGURE = "search.csv", "search.md", "search"
SEARCH_METHODS = ("tpe", "random")
NO_VALIDATION, EVIDENCE = "NoValidation", "EvidenceScore"
# What the evidence can compare: the model of the chain and the search for its weights, under one network and record.
COMPARABLE = (
    "system", "scheme.parameter_uncertainty", "scheme.unknown", "scheme.initial", "scheme.prior_width",
    "training.learn_spread", "training.iterations", "training.tolerance",
)  # fmt: skip
# Columns before those of the settings that are searched: a row per trial that has ended.
LEADING = ("trial", "state", "score", "seconds", "directory", "reason")
BEST_SHOWN = 10
# Fewer trials than this say nothing about a setting.
FEWEST_TRIALS = 5
# Of panels. Numbers that span more than a factor stand on a logarithmic axis.
PANELS_IN_A_ROW, WIDE = 3, 10.0


class Search:
    """A search for the settings with the least validation score.

    The first trial has the settings as they are configured, where the search may choose them: nothing that it finds is
    worse than what a run without it has.

    Args:
        hydra_context: Of the sweep, as are the next two.
        task_function: What a job runs; it returns its score, None where there is none.
        config: With its `hydra` node.
        sampler: `method` (``tpe``, the tree-structured Parzen estimator of Bergstra et al. 2011, or ``random``), `seed`
            of all draws, and `startup`, the random trials before the estimator is trusted.
        n_trials: In all, those of an earlier start included.
        n_jobs: Trials at a time.
        params: What settings may be, besides those on the command line.

    Raises:
        InputError: A setting outside its range, nothing that scores the trials, or another search in the directory.
    """

    def __init__(
        self,
        hydra_context: HydraContext,
        task_function: TaskFunction,
        config: DictConfig,
        sampler: Mapping[str, Any],
        n_trials: int = 30,
        n_jobs: int = 1,
        params: Mapping[str, str] | None = None,
    ) -> None:
        self.config, self.directory = config, Path(config.hydra.sweep.dir)
        self.method = one_of("hydra.sweeper.sampler.method", sampler["method"], SEARCH_METHODS)
        self.seed = whole_number("hydra.sweeper.sampler.seed", sampler["seed"])
        self.startup = whole_number("hydra.sweeper.sampler.startup", sampler["startup"], least=1)
        self.n_trials = whole_number("hydra.sweeper.n_trials", n_trials)
        self.n_jobs = whole_number("hydra.sweeper.n_jobs", n_jobs, least=1)
        self.params = [f"{name}={choices}" for name, choices in (params or {}).items()]
        self.validation = str(OmegaConf.select(config, "validation._target_")).rpartition(".")[2]
        if self.validation == NO_VALIDATION:
            allowed = "heldout, forecast or evidence in a search"
            raise InputError("validation", "none", allowed, "it is the score that is minimised")
        optuna.logging.set_verbosity(logging.WARNING)
        elsewhere = not str(config.hydra.launcher.get("_target_")).endswith("SerialLauncher")
        if elsewhere and self.n_jobs == 1:
            tell("one trial at a time: hydra.sweeper.n_jobs=2 has two at once")
        self.launcher = Plugins.instance().instantiate_launcher(
            hydra_context=hydra_context, task_function=task_function, config=config
        )

    def run(self, arguments: Sequence[str]) -> None:
        """Make the trials that are missing, write the report and print it.

        Raises:
            InputError: The score cannot compare what is searched, or no trial has one.
        """
        space, fixed = read_space([*self.params, *arguments])
        self._check_comparable(space)
        self._check_same()
        begin_sweep(self.config)
        trials: list[FrozenTrial] = []
        rows: list[dict[str, Any]] = []
        commands: list[list[str]] = []
        while len(trials) < self.n_trials:
            numbers, began = range(len(trials), min(len(trials) + self.n_jobs, self.n_trials)), datetime.now()
            drawn = [self._draw(number, trials, space) for number in numbers]
            jobs = [[f"{n}={'null' if v is None else v}" for n, v in (draw | fixed).items()] for draw in drawn]
            commands += jobs
            returned = self.launcher.launch(jobs, initial_job_idx=len(trials))
            for draw, result in zip(drawn, returned, strict=True):
                score = _score(result)
                trial = create_trial(value=score, params=draw, distributions=space, user_attrs=fixed,
                                     state=TrialState.FAIL if score is None else TrialState.COMPLETE)  # fmt: skip
                trial.datetime_start, trial.datetime_complete = began, datetime.now()
                rows.append(self._row(len(trials), trial, result))
                trials.append(trial)
                ended = "failed" if score is None else f"score {score:.5g}"
                scores = [trial.value for trial in trials if trial.value is not None]
                tell(f"{len(trials)} of {self.n_trials}  {ended}{f'  best {min(scores):.5g}' if scores else ''}")
            write_table(pd.DataFrame(rows), self.directory / TABLE)
        scored = {number: trial.value for number, trial in enumerate(trials) if trial.value is not None}
        if trials and not scored:
            allowed = "given settings under which a trial ends with a score"
            reason = next((f": {row['reason']}" for row in rows if row["reason"]), "")
            raise InputError("hydra/sweeper", "search", allowed, f"every trial failed{reason}")
        if trials:
            # As Optuna keeps them, for its own tools: nothing here reads them.
            logging.getLogger("alembic").setLevel(logging.WARNING)  # it tells of every table that Optuna makes
            with replacing(self.directory / SEARCH_FILE) as temporary:
                optuna.create_study(study_name="search", storage=f"sqlite:///{temporary}").add_trials(trials)
            # A value that needs no quotes in Hydra's grammar may need them in the shell's.
            command = shlex.join(["pinn-run", *commands[min(scored, key=lambda number: scored[number])]])
            tell(printable(report_search(pd.DataFrame(rows), command, self.directory)), sys.stdout)

    def _check_same(self) -> None:
        """Refuse a directory in which there is another search."""
        there = None
        with suppress(InputError):  # there is no sweep, or it cannot be read
            there = Sweep.read(self.directory)
        if there is None or not there.is_search:
            return
        both = there, Sweep.of(self.config, self.directory)
        before, now = ({o for o in sweep.overrides if not is_left_out(setting_of(o))} for sweep in both)
        if before != now:
            allowed = "another directory: there is a search with other settings in this one"
            differ = f"they differ in {', '.join(sorted(before ^ now))}"
            raise InputError("hydra.sweep.dir", "(as given)", allowed, differ)

    def _check_comparable(self, space: Mapping[str, BaseDistribution]) -> None:
        for name in space if self.validation == EVIDENCE else ():
            if not name.startswith(COMPARABLE):
                hint = f"{name} changes what the evidence is relative to; validation=heldout compares it"
                raise InputError("validation", "evidence", f"used in searches over {', '.join(COMPARABLE)}", hint)

    def _draw(
        self, number: int, before: Sequence[FrozenTrial], space: Mapping[str, BaseDistribution]
    ) -> dict[str, Any]:
        """The settings of a trial, drawn in memory from those before it, with a seed of its own."""
        # On every machine the same; below 2^32.
        seed = int.from_bytes(hashlib.sha256(f"{self.seed}/{number}".encode()).digest()[:4], "little")
        tpe = self.method == "tpe"
        sampler: BaseSampler = TPESampler(n_startup_trials=self.startup, seed=seed) if tpe else RandomSampler(seed=seed)
        study = optuna.create_study(sampler=sampler)
        study.add_trials(before)
        if number == 0:
            configured = {name: within(space[name], _configured(self.config, name)) for name in space}
            study.enqueue_trial({name: value for name, value in configured.items() if value is not None})
        return study.ask(dict(space)).params

    def _row(self, number: int, trial: FrozenTrial, result: JobReturn) -> dict[str, Any]:
        """Of `search.csv`."""
        hydra: Any = result.hydra_cfg
        place = Path(hydra.hydra.runtime.output_dir)
        run, failure, scored = read_record(place), Failure.read(place), trial.value is not None
        seconds = run.get("seconds", {}).get("total")
        if seconds is None and trial.duration is not None:
            seconds = trial.duration.total_seconds()
        reason = failure.reason if failure else run.get("validation", {}).get("reason")
        return {
            "trial": number,
            "state": "done" if scored else "failed",
            "score": trial.value,
            "seconds": seconds,
            "directory": place.relative_to(self.directory.absolute()).as_posix(),
            "reason": None if scored else reason,
            **trial.params,
        }


def _score(result: JobReturn) -> float | None:
    """What a job returned; None where it has no score, or failed."""
    try:
        score = float(result.return_value)
    except Exception:
        return None
    return score if math.isfinite(score) else None


def _configured(config: DictConfig, name: str) -> Any:
    """What a setting, or a config group, is without the search; None where that is no single value."""
    value = OmegaConf.select(config, name)
    if isinstance(value, DictConfig):
        return OmegaConf.select(config, "hydra.runtime.choices").get(name)
    return None if OmegaConf.is_config(value) else value


def read_space(overrides: Iterable[str]) -> tuple[dict[str, BaseDistribution], dict[str, str]]:
    """The settings that are searched, name to distribution, and the values of the others as text.

    Of overrides for one setting, as typed, the last counts.
    """
    space: dict[str, BaseDistribution] = {}
    fixed: dict[str, str] = {}
    for override in map(parse, overrides):
        name = override.get_key_element()
        space.pop(name, None)
        fixed.pop(name, None)
        if override.is_sweep_override():
            space[name] = distribution(override)
        else:
            fixed[name] = override.get_value_element_as_str()
    return space, fixed


def distribution(override: Override) -> BaseDistribution:
    """Of `choice(a,b)`, `a,b`, `range(1,4)` with both its ends, `interval(1,3)`, `tag(log,interval(1,3))`."""
    value = override.value()
    if isinstance(value, IntervalSweep):
        return _numbers(value.start, value.end, log="log" in value.tags)
    if isinstance(value, RangeSweep):  # an order, as shuffle gives it one, means nothing here
        return _numbers(value.start, value.stop, step=value.step)
    choices: list[Any] = list(override.sweep_iterator(transformer=Transformer.encode))
    return CategoricalDistribution(choices)


def _numbers(low: Any, high: Any, step: Any = None, log: bool = False) -> BaseDistribution:
    if all(isinstance(number, int) for number in (low, high, 1 if step is None else step)):
        return IntDistribution(low, high, log=log, step=1 if step is None else step)
    return FloatDistribution(low, high, log=log, step=step)


def within(distribution: BaseDistribution, value: Any) -> Any:
    """The value as the distribution has it; None where it cannot be drawn from it."""
    if isinstance(distribution, CategoricalDistribution):
        alike = (c for c in distribution.choices if c == value and isinstance(c, bool) == isinstance(value, bool))
        return next(alike, None)
    if isinstance(value, bool) or not isinstance(value, int | float) or value != value:
        return None
    low, high, step = distribution.low, distribution.high, distribution.step
    if not low <= value <= high or (step and (value - low) % step):
        return None
    return int(value) if isinstance(distribution, IntDistribution) else float(value)


def report_search(trials: pd.DataFrame, command: str, directory: Path) -> str:
    """Write the report of a search: trials as `search.csv` has them, one of which has a score, and the best's command.

    Returns:
        The best settings as a command, in a line or two for the terminal.
    """
    done = trials[trials["score"].notna()]
    shares = {name: importance(done[name], done["score"]) for name in trials.columns if name not in LEADING}
    style.save(search_figure(trials, shares), directory, FIGURE)
    write_text(_text(trials, shares, command), directory / TEXT)
    best = done.iloc[int(done["score"].argmin())]
    return f"best of {len(done)} trials: score {best['score']:.5g} (trial {best['trial']}), with\n{command}"


def importance(values: pd.Series, score: pd.Series) -> float:
    """Share of the variance of the scores' ranks that a setting explains by itself, 0 to 1, adjusted for its freedom.

    A parabola in the ranks of a number, the group means of a choice; NaN with too few trials or a single value. Trials
    of a search crowd where it is good, so this ranks settings within a search and is no property of the estimator.
    """
    ranks = score.rank().to_numpy(float)
    numbers = pd.to_numeric(values, errors="coerce")
    if numbers.notna().all() and numbers.nunique() > 2:
        x = numbers.rank().to_numpy(float)
        design = np.vander((x - x.mean()) / x.std(), 3)
    else:
        design = pd.get_dummies(values.astype(str)).to_numpy(float)
    freedom = len(ranks) - design.shape[1]
    if len(ranks) < FEWEST_TRIALS or freedom < 1 or values.astype(str).nunique() < 2 or np.ptp(ranks) == 0:
        return float("nan")
    rest = ranks - design @ np.linalg.lstsq(design, ranks, rcond=None)[0]
    return float(max(0.0, 1.0 - (rest @ rest / freedom) / np.var(ranks, ddof=1)))


def _text(trials: pd.DataFrame, shares: Mapping[str, float], command: str) -> str:
    done, failed, first = trials[trials["score"].notna()], trials[trials["state"] == "failed"], trials.iloc[0]
    best = done.sort_values("score").head(BEST_SHOWN)
    shown = best[["trial"]].assign(score=best["score"].map("{:.5g}".format), s=best["seconds"].map("{:.1f}".format))
    for name in shares:
        shown[name] = best[name].map(lambda value: f"{value:.4g}" if isinstance(value, float) else value)
    explained = pd.Series(shares, dtype=float).sort_values(ascending=False, kind="stable")
    percent = [f"{100 * share:.0f} %" if share == share else "-" for share in explained]
    as_configured = f"Trial 0, with the settings as configured where the search may choose them: {first['score']:.5g}."
    counted = f"{len(trials)} trials, {len(done)} with a score, {len(failed)} failed"
    counted += f"; {trials['seconds'].sum():.0f} s of runs in all. Lower is better."
    lines = [
        "# Search", "",
        counted, "",
        *([as_configured, ""] if first["state"] == "done" else []),
        "The best settings:", "", "```", command, "```", "",
        f"![Score of every trial, and against every setting]({FIGURE}.png)", "",
        "How much of the ranks of the scores each setting explains by itself:", "",
        *_markdown(pd.DataFrame({"setting": [f"`{name}`" for name in explained.index], "share": percent})), "",
        f"The best {len(best)} trials:", "",
        *_markdown(shown),
    ]  # fmt: skip
    if len(failed):
        lines += ["", "Failed:", "", *_markdown(failed[["trial", "reason"]].fillna(""))]
    return "\n".join(lines)


def _markdown(table: pd.DataFrame) -> list[str]:
    rows = [table.columns, ["---"] * table.shape[1], *table.astype(object).to_numpy()]
    lines = ([re.sub(r"[|\n]", " ", str(cell)) for cell in row] for row in rows)
    return [f"| {' | '.join(cells)} |" for cells in lines]


def search_figure(trials: pd.DataFrame, importances: Mapping[str, float]) -> Figure:
    """Draw the score of every trial that has one above the best, in the order of the trials and against every setting.

    One trial at least has a score; an importance is NaN where it is unknown.
    """
    done = trials[trials["score"].notna()]
    above = done["score"] - done["score"].min()
    rows = math.ceil(len(importances) / PANELS_IN_A_ROW)
    with style.look():
        figure = Figure(figsize=(style.PAGE_WIDTH, 2.1 + 1.75 * rows), layout="constrained")
        grid = figure.add_gridspec(1 + rows, PANELS_IN_A_ROW)
        history = figure.add_subplot(grid[0, :])
        _history(history, trials, done["trial"], above)
        for index, (setting, share) in enumerate(importances.items()):
            axes = figure.add_subplot(grid[1 + index // PANELS_IN_A_ROW, index % PANELS_IN_A_ROW], sharey=history)
            _slice(axes, done[setting], above)
            axes.set_title(setting if math.isnan(share) else f"{setting}\nexplains {100 * share:.0f} %", fontsize=7)
            axes.tick_params(labelleft=index % PANELS_IN_A_ROW == 0)
            if index % PANELS_IN_A_ROW == 0:
                axes.set_ylabel("above the best (nats)")
        if (above > 0.0).any():  # linear next to the best: bad trials are bad by orders of magnitude
            linear = max(float(above[above > 0.0].quantile(0.1)), 1e-12)
            history.set_yscale("symlog", linthresh=linear)
            history.set_ylim(-0.3 * linear, 2.0 * float(above.max()) + linear)
            history.minorticks_off()
    return figure


def _history(axes: Axes, trials: pd.DataFrame, number: pd.Series, above: pd.Series) -> None:
    axes.plot(number, above, "o", markersize=3, color=style.BLUE, label="trial")
    axes.step(number, np.minimum.accumulate(above), where="post", color=style.VERMILLION, label="best so far")
    for index, failed in enumerate(trials.loc[trials["state"] == "failed", "trial"]):
        axes.axvline(failed, color=style.GREY, linewidth=0.8, linestyle=":", label="" if index else "failed")
    axes.set(xlabel="trial", ylabel="score above\nthe best (nats)")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend(loc="upper right", ncols=3)


def _slice(axes: Axes, values: pd.Series, above: pd.Series) -> None:
    place = pd.to_numeric(values, errors="coerce")
    if place.notna().all() and values.nunique() > 2:
        if place.min() > 0 and place.max() > WIDE * place.min():
            axes.set_xscale("log")
    else:
        names = sorted(set(values.astype(str)))
        # Side by side in the order of the trials, so that equal ones do not hide each other.
        place = values.astype(str).map(names.index) + np.linspace(-0.25, 0.25, len(values))
        axes.set_xticks(range(len(names)), names)
        axes.set_xlim(-0.6, len(names) - 0.4)
    axes.plot(place, above, "o", markersize=3, color=style.BLUE)
    best = int(above.argmin())
    axes.plot([place.iloc[best]], [0.0], "o", markersize=6, markerfacecolor="none", color=style.VERMILLION)
