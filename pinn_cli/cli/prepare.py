"""From settings to a problem, or to a run by windows, that is ready to be solved: what precedes every estimate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from pinn_cli.cli.records import RECORDS_SETTING
from pinn_cli.cli.source import measured_by_name
from pinn_cli.runs.stages import Stages
from pinn_cli.settings.errors import InputError

if TYPE_CHECKING:
    from pinn_cli.cli.config import RunConfig
    from pinn_cli.record.record import Measurements, Record, Truth
    from pinn_cli.record.validation_data import ValidationRecord
    from pinn_cli.record.windows import Window
    from pinn_cli.scheme.joint_problem import JointProblem
    from pinn_cli.sweep.windowed_run import WindowedRun
    from pinn_cli.system.structure import Structure
    from pinn_cli.training.estimate import RunContext
    from pinn_cli.training.estimator import Estimator, TrainedNetwork
    from pinn_cli.validation.validation import Validation


@dataclass(frozen=True, eq=False)
class PreparedProblem:
    """What an estimator is given, and what it is scored against.

    Attributes:
        true: The system that a simulated record comes from.
        prescribed: The model that the estimator is given.
        record: What it may see; of several records the first.
        truth: What it is scored against, and nothing else; of several records that of the first.
        problem: What it solves.
        truths: Of every record.
        validation: What the identified system is tried on, of which no estimator is told; None: nothing.
    """

    true: Structure
    prescribed: Structure
    record: Record
    truth: Truth
    problem: JointProblem
    truths: tuple[Truth, ...]
    validation: ValidationRecord | None = None


def prepare_problem(config: RunConfig, stages: Stages | None = None) -> PreparedProblem:
    """Simulate or read the record and set up the problem, timed as the stages ``system``, ``record`` and ``problem``.

    Raises:
        InputError: A setting or a file that no run can use.
    """
    from pinn_cli.scheme.joint_problem import tell_if_unreached
    from pinn_cli.scheme.modal_problem import modal_problem

    stages = stages or Stages()
    with stages("system"):
        true, prescribed = _structures(config)
    with stages("record"):
        measurements = config.source.measurements(true)
        records = [config.observe(measured.record) for measured in measurements]
        validate = config.source.validate
        validation = None if validate is None else validate(true, records)
    with stages("problem"):
        if config.modes is None:
            prescribed = config.scheme.adapted(prescribed, records)
            problem = config.scheme.pose(prescribed, records)
        else:
            problem = modal_problem(config.modes, prescribed, records)
            prescribed = problem.structure
        tell_if_unreached(problem)
    truths = tuple(measured.truth for measured in measurements)
    return PreparedProblem(true, prescribed, records[0], truths[0], problem, truths, validation)


def _structures(config: RunConfig) -> tuple[Structure, Structure]:
    """The true one and the prescribed one."""
    true, prescribed = config.model_error.structures(config.structure)
    return true, prescribed if config.model is None else config.model.structure


def check_records(
    problem: JointProblem, estimator: TrainedNetwork, baseline: Estimator | None, validation: Validation
) -> None:
    """Refuse what has one record at a time, where there are several."""
    if len(problem) == 1:
        return
    several = f"with the {len(problem)} records of {RECORDS_SETTING}"
    if not estimator.solves_records:
        allowed = f"spline or fourier, with training=gauss_newton and inferred weights, {several}"
        raise InputError("network", estimator.design.name, allowed, "other trainings have one record at a time")
    if baseline is not None and not baseline.solves_records:
        raise InputError("baseline", baseline.name, f"none {several}", "it smooths one record")
    if not validation.scores_records:
        hint = "it withholds parts of one record"
        raise InputError("validation", validation.name, f"none or evidence {several}", hint)


def check_windows(config: RunConfig) -> None:
    """Refuse what is about a record as a whole, where it is solved by windows."""
    source = config.source
    refused = (
        (not config.scheme.has_windows, "scheme", config.scheme.name, "sparse_recovery, state_parameter or update",
         "it solves a record as a whole"),
        (bool(source.further), "data.records", f"{1 + len(source.further)} records", "one",
         "each record has windows of its own: one run after the other, model=... with scheme=update"),
        (source.validate is not None, "data.validation", "given", "null",
         "give data.start and data.stop, and try the run on the rest with scheme=predict"),
        (config.validation.name != "none", "validation", config.validation.name, "none",
         "it withholds parts of one record"),
        (config.baseline is not None, "baseline", getattr(config.baseline, "name", ""), "none",
         "it smooths one record"),
        (config.between is not None, "report.between", config.between, "null",
         "figures of a run by windows show parameters, and no histories"),
        (not config.training.solves_inputs(config.network), "network", config.network.name,
         "spline, with training=gauss_newton and inferred weights,", "other trainings know no first state"),
    )  # fmt: skip
    for is_refused, setting, value, allowed, hint in refused:
        if is_refused:
            raise InputError(setting, value, f"{allowed} with data.window", hint)


def prepare_windows(
    config: RunConfig,
    context: RunContext,
    stages: Stages,
    say: Callable[[str], None],
    *,
    goes_on: bool,
    drawn: bool,
    follows: bool = False,
) -> WindowedRun:
    """A run by windows whose first window has been found good; its context has the run's directory.

    It says a line for every window, goes on with windows that are there or not, and follows a record that still grows.

    Raises:
        InputError: No run can use the record, or the windows that are there are another run's.
    """
    from pinn_cli.report.parameters import history
    from pinn_cli.sweep.window_store import WindowStore
    from pinn_cli.sweep.windowed_run import WindowedRun, WindowSolver
    from pinn_cli.training.changes import UpdatedNetwork

    windows, directory = config.source.windows, context.directory
    assert windows is not None
    assert directory is not None
    check_windows(config)
    with stages("system"):
        true, prescribed = _structures(config)

    def measured(window: Window) -> Measurements:
        return measured_by_name(partial(windows.measure, true, window), true.labels)

    last_record = 0
    if config.model is None:
        begin = measured(next(windows.after(0)))
        prescribed = config.scheme.adapted(prescribed, [config.observe(begin.record)])
    elif config.scheme.looks_for_changes:
        last_record = int(history(config.model)["record"].max())
    solver = WindowSolver(
        config.description, config.scheme, config.estimator, UpdatedNetwork(config.training, config.network), true,
        prescribed, measured, config.observe, config.source.simulated, config.model, context, last_record,
    )  # fmt: skip
    store, identity = WindowStore(directory), config.identity.configuration
    there = store.identity()
    if there not in (None, identity):
        if follows:
            allowed, hint = "one of its own for every record and its settings", "windows of another run lie there"
            raise InputError("hydra.run.dir", directory, allowed, f"{hint}: case=... or another")
        if goes_on:
            hint = "what follow has begun, pinn-run follow goes on with"
            raise InputError("resume", directory, "windows of this very record and settings", hint)
    goes_on = (goes_on or follows) and there == identity
    if not (goes_on and store.done):
        with stages("record"):
            first = next(windows.after(0))
        problem, _ = solver.posed(first, None)
        for estimator in (solver.first, solver.later):
            estimator.check(problem.alone)
    return WindowedRun(solver, windows, directory, identity, goes_on, config.exports, drawn, say, follows)
