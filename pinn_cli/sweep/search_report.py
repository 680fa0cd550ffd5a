"""What a search leaves behind: search.csv, search.md and a figure, of one that has ended or is under way."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from pinn_cli.report.figures import style
from pinn_cli.runs.writing import write_table, write_text
from pinn_cli.sweep.search_figure import search_figure
from pinn_cli.sweep.search_trials import LEADING, importance, load_study, overrides_of, trials_table

if TYPE_CHECKING:
    import pandas as pd
    from optuna.study import Study

TABLE, TEXT, FIGURE = "search.csv", "search.md", "search"
BEST_SHOWN = 10


def report_search(directory: Path) -> str:
    """Write the report of the search in a sweep's directory.

    Returns:
        The best settings as a command, in a line or two for the terminal; empty where there is no search.
    """
    study = load_study(directory)
    if study is None:
        return ""
    trials = trials_table(study, directory)
    write_table(trials, directory / TABLE)
    done = trials[trials["score"].notna()]
    if done.empty:
        text = f"search: none of {len(trials)} trials has a score; {TABLE} has the reasons"
        write_text(f"# Search\n\n{text}", directory / TEXT)
        return text
    settings = [name for name in trials.columns if name not in LEADING]
    shares = {name: importance(done[name], done["score"]) for name in settings}
    style.save(search_figure(trials, settings, shares), directory, FIGURE)
    command = best_command(study)
    write_text(_text(trials, settings, shares, command), directory / TEXT)
    best = done.iloc[int(done["score"].argmin())]
    return f"best of {len(done)} trials: score {best['score']:.5g} (trial {best['trial']}), with\n{command}"


def best_command(study: Study) -> str:
    """The command line of the best trial's run."""
    # A value that needs no quotes in Hydra's grammar may need them in the shell's.
    return shlex.join(["pinn-run", *overrides_of(study.best_trial)])


def _text(trials: pd.DataFrame, settings: list[str], shares: dict[str, float], command: str) -> str:
    done, failed = trials[trials["score"].notna()], trials[trials["state"] == "failed"]
    best = done.sort_values("score").head(BEST_SHOWN)
    order = sorted(settings, key=lambda name: -(shares[name] if shares[name] == shares[name] else -1.0))
    seconds = f"{trials['seconds'].sum():.0f} s of runs in all"
    counted = f"{len(trials)} trials, {len(done)} with a score, {len(failed)} failed; {seconds}. Lower is better."
    lines = [
        "# Search", "",
        counted, "",
        *_first(trials.iloc[0]),
        "The best settings:", "", "```", command, "```", "",
        f"![Score of every trial, and against every setting]({FIGURE}.png)", "",
        "How much of the ranks of the scores each setting explains by itself:", "",
        *_table([[f"`{name}`", _percent(shares[name])] for name in order], ["setting", "share"]), "",
        f"The best {len(best)} trials:", "",
        *_table([_cells(row, settings) for _, row in best.iterrows()], ["trial", "score", "s", *settings]),
    ]  # fmt: skip
    if len(failed):
        rows = [[str(row["trial"]), str(row["reason"] or "")] for _, row in failed.iterrows()]
        lines += ["", "Failed:", "", *_table(rows, ["trial", "reason"])]
    return "\n".join(lines)


def _first(trial: pd.Series) -> list[str]:
    if trial["state"] != "done":
        return []
    return [f"Trial 0, with the settings as configured where the search may choose them: {trial['score']:.5g}.", ""]


def _cells(row: pd.Series, settings: list[str]) -> list[str]:
    seconds = "" if row["seconds"] != row["seconds"] else f"{row['seconds']:.1f}"
    return [str(row["trial"]), f"{row['score']:.5g}", seconds, *(_value(row[name]) for name in settings)]


def _value(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _percent(share: float) -> str:
    return "-" if share != share else f"{100 * share:.0f} %"


def _table(rows: list[list[str]], header: list[str]) -> list[str]:
    bars = ["---"] * len(header)
    lines = ([re.sub(r"[|\n]", " ", cell) for cell in cells] for cells in (header, bars, *rows))
    return [f"| {' | '.join(cells)} |" for cells in lines]
