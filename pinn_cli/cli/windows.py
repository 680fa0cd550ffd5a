"""`data.window`: from the configuration to a run by windows, and what such a run has not."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from pinn_cli.cli.dof_names import named
from pinn_cli.runs.stages import Stages
from pinn_cli.settings.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from pinn_cli.cli.config import RunConfig
    from pinn_cli.record.record import Measurements
    from pinn_cli.record.windows import Window
    from pinn_cli.system.structure import Structure
    from pinn_cli.training.estimate import RunContext
    from pinn_cli.windows.run import WindowedRun

WITH = "with data.window"


def check_windows(config: RunConfig) -> None:
    """Refuse what is about a record as a whole.

    Raises:
        InputError: Naming the setting.
    """
    if not config.scheme.has_windows:
        allowed = f"sparse_recovery, state_parameter or update {WITH}"
        raise InputError("scheme", config.scheme.name, allowed, "it solves a record as a whole")
    if config.source.further:
        hint = "each record has windows of its own: one run after the other, model=... with scheme=update"
        raise InputError("data.records", f"{1 + len(config.source.further)} records", f"one {WITH}", hint)
    if config.source.validate is not None:
        hint = "give data.start and data.stop, and try the run on the rest with scheme=predict"
        raise InputError("data.validation", "given", f"null {WITH}", hint)
    if config.validation.name != "none":
        raise InputError("validation", config.validation.name, f"none {WITH}", "it withholds parts of one record")
    if config.baseline is not None:
        raise InputError("baseline", config.baseline.name, f"none {WITH}", "it smooths one record")
    if not config.training.solves_inputs(config.network):
        allowed = f"spline, with training=gauss_newton and inferred weights, {WITH}"
        raise InputError("network", config.network.name, allowed, "other trainings know no first state")


def windowed_run(
    config: RunConfig,
    directory: Path,
    context: RunContext,
    stages: Stages,
    *,
    goes_on: bool,
    drawn: bool,
    say: Callable[[str], None],
    follows: bool = False,
) -> WindowedRun:
    """A run by windows whose first window has been found good.

    Args:
        config: Of the run.
        directory: Of it.
        context: What its estimators are given.
        stages: Of the run.
        goes_on: Whether it goes on with windows that are there.
        drawn: Whether there are figures.
        say: Called with a line for every window.
        follows: Whether its record may still grow.

    Raises:
        InputError: No run can use the record, or the windows that are there are another run's.
    """
    from pinn_cli.report.parameters import history
    from pinn_cli.training.updating import UpdatedNetwork
    from pinn_cli.windows.run import WindowedRun
    from pinn_cli.windows.solving import WindowSolver
    from pinn_cli.windows.store import WindowStore

    windows = config.source.windows
    assert windows is not None
    check_windows(config)
    with stages("system"):
        true, prescribed = config.model_error.structures(config.structure)
        prescribed = prescribed if config.model is None else config.model.structure
    updates = config.scheme.looks_for_changes and config.model is not None
    if config.model is None:
        begin = _measured(config, true, next(windows.after(0)))
        prescribed = config.scheme.damped(prescribed, [config.observe(begin.record)])
    solver = WindowSolver(
        config.description, config.scheme, config.estimator, UpdatedNetwork(config.training, config.network), true,
        prescribed, partial(_measured, config, true), config.observe, config.source.simulated, config.model, context,
        int(history(config.model)["record"].max()) if updates and config.model is not None else 0,
    )  # fmt: skip
    store, identity = WindowStore(directory), config.identity.configuration
    _check_place(store.identity(), identity, directory, resuming=goes_on, follows=follows)
    goes_on = (goes_on or follows) and store.identity() == identity
    if not (goes_on and store.done):
        with stages("record"):
            first = next(windows.after(0))
        problem, _ = solver.posed(first, None)
        for estimator in (solver.first, solver.later):
            estimator.check(problem.alone)
    return WindowedRun(solver, windows, directory, identity, goes_on, config.exports, drawn, say, follows)


def _check_place(there: str | None, own: str, directory: Path, *, resuming: bool, follows: bool) -> None:
    """Refuse windows of another run where this one is to go on.

    Raises:
        InputError: Naming the directory.
    """
    if there in (None, own):
        return
    if follows:
        allowed = "one of its own for every record and its settings"
        raise InputError("hydra.run.dir", directory, allowed, "windows of another run lie there: case=... or another")
    if resuming:
        hint = "what follow has begun, pinn-run follow goes on with"
        raise InputError("resume", directory, "windows of this very record and settings", hint)


def _measured(config: RunConfig, true: Structure, window: Window) -> Measurements:
    windows = config.source.windows
    assert windows is not None
    return named(lambda structure: windows.measure(structure, window), true, true.labels)
