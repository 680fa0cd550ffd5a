"""The trials of a search: the SQLite file that Optuna keeps them in, as a table, and how much each setting mattered."""

from __future__ import annotations

import logging
import math
import re
import sqlite3
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pandas as pd
from optuna.study import Study
from optuna.trial import FrozenTrial

from pinn_cli.runs.identity import is_left_out
from pinn_cli.runs.reading import check_layout, check_regular, stamp
from pinn_cli.runs.resume import read_record
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.override_syntax import setting_of
from pinn_cli.sweep.failure import Failure
from pinn_cli.sweep.jobs import job_directories, stored_overrides

# In the sweep's directory; the trials in it have ended.
FILE, NAME, FORMAT = "search.db", "search", 1
# Attribute of the study: the overrides that it was started with.
OVERRIDES = "overrides"
LEADING = ("trial", "state", "score", "seconds", "directory", "reason")
# Fewer trials than this say nothing about a setting.
FEWEST = 5
_SETTING = re.compile(r"[\w./@~+-]+", re.ASCII)


def create_study(directory: Path) -> Study:
    """The study in a sweep's directory, a new one where there is none."""
    study = optuna.create_study(study_name=NAME, storage=f"sqlite:///{directory / FILE}", load_if_exists=True)
    for name, value in stamp(FORMAT).items():
        study.set_user_attr(name, value)
    return study


def load_study(directory: Path) -> Study | None:
    """The study in a sweep's directory; None where there is none.

    Raises:
        InputError: The file there is none that this release of Optuna reads, or a later one of this package wrote it.
    """
    optuna.logging.set_verbosity(logging.WARNING)
    logging.getLogger("alembic").setLevel(logging.WARNING)  # it tells of every table that Optuna makes
    if not (directory / FILE).is_file():
        return None
    try:
        if not _is_plain(directory / FILE):
            return None
        study = optuna.load_study(study_name=NAME, storage=f"sqlite:///{directory / FILE}")
        check_layout(study.user_attrs, FORMAT, directory / FILE)
        _check(study)
    except InputError:
        raise
    except Exception as error:  # of another release; damaged, of which Optuna and SQLAlchemy raise dozens of kinds
        allowed = f"a directory whose {FILE} was written by this release of Optuna"
        reason = str(error).strip().partition("\n")[0] or type(error).__name__
        raise InputError("hydra.sweep.dir", directory, allowed, reason) from error
    return study


def _is_plain(file: Path) -> bool:
    """Whether there is a study in the file, whose tables are none that are computed.

    Raises:
        OSError, ValueError, sqlite3.Error: They are, or it is no such file.
    """
    check_regular(file)
    with closing(sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro", uri=True)) as database:
        kinds = {kind for (kind,) in database.execute("SELECT type FROM sqlite_master")}
        if kinds - {"table", "index"}:
            raise ValueError(f"it holds {', '.join(sorted(kinds - {'table', 'index'}))}s")
        # cut off before it was made
        return bool(kinds) and bool(database.execute("SELECT 1 FROM studies WHERE study_name = ?", (NAME,)).fetchall())


def _check(study: Study) -> None:
    """See to it that its trials are read, and are as a search makes them.

    Raises:
        ValueError: They are not.
        Exception: Whatever Optuna says of what it cannot read.
    """
    known = study.user_attrs.get(OVERRIDES, [])
    if not isinstance(known, list) or not all(isinstance(override, str) for override in known):
        raise ValueError(f"its {OVERRIDES} are no texts")
    for number, trial in enumerate(study.get_trials(deepcopy=False)):
        settings = trial.params | trial.user_attrs
        if trial.number != number or not trial.state.is_finished():
            raise ValueError(f"trial {number} has not ended")
        if not all(_SETTING.fullmatch(name) for name in settings):
            raise ValueError(f"trial {number} sets what is no setting")
        if not all(value is None or isinstance(value, str | int | float) for value in settings.values()):
            raise ValueError(f"trial {number} has values that are none")
        if trial.value is not None and not math.isfinite(trial.value):
            raise ValueError(f"trial {number} has a score that is no number")


def overrides_of(trial: FrozenTrial) -> list[str]:
    """The overrides of a trial's job."""
    values = {**trial.params, **trial.user_attrs}
    return [f"{name}={'null' if value is None else value}" for name, value in values.items()]


def trials_table(study: Study, directory: Path) -> pd.DataFrame:
    """One row per trial in the order of their numbers: `LEADING`, then the settings that were searched.

    Args:
        study: Of the search.
        directory: Of the sweep, which the column ``directory`` starts from.
    """
    jobs = {_key(stored_overrides(job)): job for job in job_directories(directory)}
    rows = [_row(trial, jobs.get(_key(overrides_of(trial))), directory) for trial in study.get_trials(deepcopy=False)]
    settings = dict.fromkeys(name for row in rows for name in row if name not in LEADING)
    return pd.DataFrame(rows, columns=[*LEADING, *settings])


def _row(trial: FrozenTrial, job: Path | None, directory: Path) -> dict[str, Any]:
    run = {} if job is None else read_record(job)
    failure = None if job is None else Failure.read(job)
    seconds = run.get("seconds", {}).get("total")
    if seconds is None and trial.duration is not None:
        seconds = trial.duration.total_seconds()
    reason = failure.reason if failure else run.get("validation", {}).get("reason")
    ended = trial.state.name == "COMPLETE"
    return {
        "trial": trial.number,
        "state": "done" if ended else "failed",
        "score": trial.value if ended else None,
        "seconds": seconds,
        "directory": None if job is None else job.relative_to(directory).as_posix(),
        "reason": None if ended else reason,
        **trial.params,
    }


def _key(overrides: Iterable[str]) -> tuple[str, ...]:
    """Settings that do not tell a job from others may change when a search goes on."""
    return tuple(sorted(override for override in overrides if not is_left_out(setting_of(override))))


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
    if len(ranks) < FEWEST or freedom < 1 or values.astype(str).nunique() < 2 or np.ptp(ranks) == 0:
        return float("nan")
    rest = ranks - design @ np.linalg.lstsq(design, ranks, rcond=None)[0]
    return float(max(0.0, 1.0 - (rest @ rest / freedom) / np.var(ranks, ddof=1)))
