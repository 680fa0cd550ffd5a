"""`inspect` and `modes`: what the commands of these names find, as tables and figures, in this process."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from pinn_cli.api.data import settings_of
from pinn_cli.api.run import ONE_AT_A_TIME, check_overrides, performed
from pinn_cli.cli.inspecting import inspected_record, modes_of_records
from pinn_cli.cli.job import Report, leave, look
from pinn_cli.cli.options import settings_of_files
from pinn_cli.runs.claim import current
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.override_syntax import quoted

if TYPE_CHECKING:
    from pinn_cli.inspection.mode_report import ModesReport
    from pinn_cli.inspection.proposal import Said
    from pinn_cli.inspection.report import InspectionReport


def inspect(
    data: Any = None,
    *overrides: str,
    directory: str | os.PathLike[str] | None = None,
    config_dir: str | os.PathLike[str] | None = None,
) -> InspectionReport:
    """Look at a record before anything is estimated, as ``pinn-run inspect`` does.

    Args:
        data: The path of a file, or a record in memory as :func:`pinn_cli.run` takes it: a pandas DataFrame, names to
            arrays, a :class:`pinn_cli.Record`, or time series as SDyPy's SEP 5 has them. What columns are is guessed
            by their names and units unless they or overrides say it. None: overrides say all.
        *overrides: Settings as the command takes them: ``"data.acceleration={1: a1}"``, ``"data.start=2"``.
        directory: Where tables and figures are written; None: nothing is.
        config_dir: A folder of more configurations.

    Returns:
        ``channels``, ``peaks`` and ``spectra`` (pandas), ``notes``, ``settings`` to run with, and ``figure()``.

    Raises:
        InputError: There is no record that can be looked at; the message is the command's one line.
        WriteError: The disk does not take what is written.

    Example:
        >>> from pinn_cli import inspect, run
        >>> found = inspect("rig.csv")  # doctest: +SKIP
        >>> found.channels  # doctest: +SKIP
        >>> result = run(*found.settings)  # doctest: +SKIP
    """
    return _looked(inspected_record, "inspect", data, overrides, directory, config_dir)


def modes(
    data: Any = None,
    *overrides: str,
    directory: str | os.PathLike[str] | None = None,
    config_dir: str | os.PathLike[str] | None = None,
) -> ModesReport:
    """Natural frequencies, damping ratios and shapes from records alone, as ``pinn-run modes`` finds them.

    Args:
        data: See :func:`inspect`; a list of frames is several records.
        *overrides: Settings as the command takes them. With the parameters of a structure (``"system=linear"``,
            ``"system.k=4e4"``, ...) its modes stand beside.
        directory: Where tables and figures are written; None: nothing is.
        config_dir: A folder of more configurations.

    Returns:
        ``modes``, ``mac`` and ``spectra`` (pandas), and ``figure()``.

    Raises:
        InputError: There is no record with a sensor of the motion; the message is the command's one line.
        WriteError: The disk does not take what is written.
    """
    return _looked(modes_of_records, "modes", data, overrides, directory, config_dir)


def _looked(
    at: Callable[[DictConfig, Path, Said], Report],
    word: str,
    data: Any,
    overrides: Sequence[str],
    directory: str | os.PathLike[str] | None,
    config_dir: str | os.PathLike[str] | None,
) -> Report:
    """What the command of this word finds."""
    check_overrides(overrides, word)
    kept: list[Report] = []

    def task(composed: DictConfig) -> None:
        kept.append(look(composed, at))
        if directory is None:
            current().untouched = True
        else:
            leave(kept[0], composed)

    with TemporaryDirectory(prefix="pinn-run-") as nowhere, ONE_AT_A_TIME, _settings(data, overrides) as of_data:
        place = Path(nowhere) / "look" if directory is None else Path(directory).expanduser().absolute()
        options = [] if config_dir is None else ["--config-dir", os.fspath(config_dir)]
        performed(task, ["pinn-run", *options, word, *of_data, *overrides, f"hydra.run.dir={quoted(str(place))}"])
    return kept[0]


@contextmanager
def _settings(data: Any, overrides: Sequence[str]) -> Iterator[list[str]]:
    """The settings that have a look read some data; what names do not say is guessed."""
    from pinn_cli.record.record import Record

    if isinstance(data, str | os.PathLike):
        yield settings_of_files([os.fspath(Path(data).expanduser())], overrides)
        return
    if isinstance(data, list | tuple) and any(isinstance(item, str | os.PathLike) for item in data):
        hint = "several records: 'data=csv', 'data.records=[{path: a.csv}, {path: b.csv}]'"
        raise InputError("data", f"a list of {len(data)}", "the path of one file, or frames", hint)
    # A structure that has the names of its DOFs may be unknown as yet: numbers are always good.
    records = data if isinstance(data, list | tuple) else [data]
    plain = [replace(record, dofs=()) if isinstance(record, Record) else record for record in records]
    with settings_of(plain if isinstance(data, list | tuple) else plain[0], overrides, lambda names: None) as settings:
        yield settings
