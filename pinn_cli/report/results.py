"""What a run hands to its report, and the leading columns that say which run a row of a table belongs to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import entries, is_finite_number
from pinn_cli.system.basis import with_functions_of
from pinn_cli.training.calibrated_record import as_calibrated

if TYPE_CHECKING:
    from pinn_cli.model.knowledge import Model
    from pinn_cli.posterior.posterior import PosteriorResult
    from pinn_cli.record.record import Record, Truth
    from pinn_cli.record.response import Response
    from pinn_cli.record.validation_data import ValidationRecord
    from pinn_cli.scheme.problem import Problem
    from pinn_cli.system.structure import Structure
    from pinn_cli.training.estimate import Estimate
    from pinn_cli.validation.validation import Score

LABELS = ("case", "estimator", "scheme", "ndof", "nonlinearity", "model_error", "snr_db", "seed")


def with_labels(table: pd.DataFrame, labels: Mapping[str, object]) -> pd.DataFrame:
    """The table with the columns of `LABELS` before its own; a label that is None leaves its column empty."""
    labelled = table.copy()
    for position, name in enumerate(LABELS):
        labelled.insert(position, name, pd.Series([labels[name]] * len(table), index=table.index))
    return labelled


def record_folder(number: int) -> str:
    """Where the files of a record lie in the run's directory; those of the first lie in the directory itself."""
    return "." if number == 1 else f"record_{number}"


@dataclass(frozen=True, eq=False)
class RunDescription:
    """Which run it is, for the files that it leaves behind.

    Attributes:
        case, seed, threads: As configured.
        configuration: Digest of the settings (`pinn_cli.runs.identity.Identity.configuration`).
        labels: The leading columns of its tables but for the estimator.
        simulated: Whether the record is.
        validation, baseline: Names of the chosen ones.
    """

    case: str
    seed: int
    threads: int
    configuration: str
    labels: Mapping[str, object]
    simulated: bool
    validation: str
    baseline: str

    def labels_of(self, estimator: str) -> dict[str, object]:
        """The leading columns of an estimator's tables (`LABELS`)."""
        return {**self.labels, "estimator": estimator}

    @property
    def truth_label(self) -> str:
        """What figures call the truth: of a measured record it is a measurement itself, noise included."""
        return "truth" if self.simulated else "measured, held out"


@dataclass(frozen=True, eq=False)
class Results:
    """All that a run has found; None where there is none.

    Attributes:
        run: Which run it is.
        prescribed: The model that the estimator was given.
        record: What the estimator saw.
        truth: What it is scored against; NaN where unknown.
        estimate: What it found.
        baseline: What the configured baseline found.
        posterior: Of the parameters, where one was asked for.
        score: Of the estimate without the truth, where one was asked for.
        problem: That was solved; without it there is no verdict.
        linear_response: Of the structure without its nonlinearity under the same force (paper, Fig. 6).
        true: The structure that a simulated record comes from, for scoring.
        validation: What the identified system is tried on and no estimator has seen.
        model: What the run began with, of an earlier run.
        shown: From when to when figures show histories, s; None: a stretch of a long record that each chooses.
        further: Of records that were solved together with this one, whose ``estimate`` then has the parameters of all.
    """

    run: RunDescription
    prescribed: Structure
    record: Record
    truth: Truth
    estimate: Estimate
    baseline: Estimate | None = None
    posterior: PosteriorResult | None = None
    score: Score | None = None
    problem: Problem | None = None
    linear_response: Response | None = None
    true: Structure | None = None
    validation: ValidationRecord | None = None
    model: Model | None = None
    shown: tuple[float, float] | None = None
    further: tuple[Results, ...] = ()

    @property
    def by_record(self) -> tuple[Results, ...]:
        """Those of every record, this one's first."""
        return (replace(self, further=(), estimate=self.estimate.by_record[0]), *self.further)


def checked_times(setting: str, between: Any, time: np.ndarray) -> tuple[float, float]:
    """From when to when figures are to show a record with times (N,), s; ``setting`` gives them, for the message.

    Raises:
        InputError: They are no two times of the record.
    """
    given = entries(between)
    if len(given) == 2 and all(map(is_finite_number, given)) and max(given[0], time[0]) < min(given[1], time[-1]):
        return float(given[0]), float(given[1])
    hint = f"the record goes from {time[0]:g} s to {time[-1]:g} s"
    raise InputError(setting, between, "two times of the record in s, the earlier one first, such as [1.2, 1.6]", hint)


def in_functions_of(truth: Truth, true: Structure, structure: Structure) -> Truth:
    """The truth with terms of curves as those of the functions that the structure of an estimate has."""
    if truth.parameters is None or set(truth.parameters) != set(structure.parameters):
        return truth
    return replace(truth, parameters=with_functions_of(true, structure).parameters_like(np.empty(0)))


def further_results(first: Results, problems: Sequence[Problem], truths: Sequence[Truth]) -> tuple[Results, ...]:
    """Those of the records that were solved together with the first one, whose estimate is that of all.

    Problems and truths are those of the other records.
    """
    alone = replace(first, baseline=None, posterior=None, score=None, linear_response=None)
    further = []
    for problem, truth, estimate in zip(problems, truths, first.estimate.by_record[1:], strict=True):
        record = as_calibrated(problem.record, estimate)
        calibrated = replace(problem, record=record)
        further.append(replace(alone, record=record, truth=truth, estimate=estimate, problem=calibrated))
    return tuple(further)
