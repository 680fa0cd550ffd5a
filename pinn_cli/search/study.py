"""The study of a search: the SQLite file in the sweep's directory that Optuna keeps the trials in that have ended."""

from __future__ import annotations

import logging
from pathlib import Path

import optuna
from optuna.study import Study

from pinn_cli.settings.errors import InputError

FILE, NAME = "search.db", "search"
# Attribute of the study: the overrides that it was started with.
OVERRIDES = "overrides"


def create_study(directory: Path) -> Study:
    """The study in a sweep's directory, a new one where there is none."""
    return optuna.create_study(study_name=NAME, storage=_address(directory), load_if_exists=True)


def load_study(directory: Path) -> Study | None:
    """The study in a sweep's directory; None where there is none.

    Raises:
        InputError: The file there is none that this release of Optuna reads.
    """
    optuna.logging.set_verbosity(logging.WARNING)
    logging.getLogger("alembic").setLevel(logging.WARNING)  # it tells of every table that Optuna makes
    if not (directory / FILE).is_file():
        return None
    try:
        return optuna.load_study(study_name=NAME, storage=_address(directory))
    except KeyError:  # cut off before it was made
        return None
    except RuntimeError as error:
        allowed = f"a directory whose {FILE} was written by this release of Optuna"
        raise InputError("hydra.sweep.dir", directory, allowed, str(error).partition("\n")[0]) from error


def _address(directory: Path) -> str:
    return f"sqlite:///{directory / FILE}"
