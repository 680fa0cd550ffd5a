"""The study of a search: the SQLite file in the sweep's directory that Optuna keeps its trials in."""

from __future__ import annotations

import logging
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from optuna.study import Study

# Optuna 2.10, all that the sweeper takes, is written for SQLAlchemy 1.4, which says so of every program that uses it.
warnings.filterwarnings("ignore", message="Deprecated API features detected")

FILE, NAME = "search.db", "search"
# Attribute of the study: the overrides that it was started with.
MADE_OF = "overrides"


def address(directory: Path) -> str:
    """Of the study's storage, as SQLAlchemy has it."""
    return f"sqlite:///{directory / FILE}"


def load(directory: Path) -> Study | None:
    """The study in a sweep's directory; None where there is none."""
    if not (directory / FILE).is_file():
        return None
    import optuna

    optuna.logging.set_verbosity(logging.WARNING)
    if NAME not in [summary.study_name for summary in optuna.get_all_study_summaries(address(directory))]:
        return None
    return optuna.load_study(study_name=NAME, storage=address(directory))


def take_up(study: Study) -> int:
    """Put trials that were under way when the search was stopped back into its queue, with their settings.

    Returns:
        How many trials have ended.
    """
    from optuna.trial import TrialState

    ended = 0
    for trial in study.get_trials(deepcopy=False):
        ended += trial.state.is_finished()
        if trial.state == TrialState.RUNNING:
            # Optuna has no public call for it: enqueue_trial would make another trial, and another draw after it.
            study._storage.set_trial_state(trial._trial_id, TrialState.WAITING)
    return ended
