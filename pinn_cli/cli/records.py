"""Several records of one structure: what each entry of `data.records` says, beside what all have in common."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.suggestion import suggestion

if TYPE_CHECKING:
    from pinn_cli.scheme.joint_problem import JointProblem
    from pinn_cli.training.base import Estimator, TrainedNetwork
    from pinn_cli.validation.base import Validation

SETTING = "data.records"
# What all records have in common.
COMMON = ("_target_", "kind", "format", "records", "validation", "window", "overlap")
# Of these, what is said of the run, not of a record.
OF_THE_RUN = ("window", "overlap")


def data_of_records(data: DictConfig) -> list[DictConfig]:
    """The settings `data` of every record: those of its entry, and of `data` itself what the entry does not name.

    A map of columns is the entry's own as a whole: where it names an accelerometer, it has no other ones.

    Raises:
        InputError: Naming `data.records`: it is no list of maps, or an entry names what is no setting of a record.
    """
    plain: Any = OmegaConf.to_container(data)
    entries = plain.pop("records", None)
    for name in OF_THE_RUN:
        plain.pop(name, None)
    if entries is None or entries == []:
        return [OmegaConf.create(plain)]
    if not isinstance(entries, list):
        raise InputError(
            SETTING, entries, "a list of maps, one for each record, such as [{path: a.csv}, {path: b.csv}]"
        )
    return [OmegaConf.create(plain | _checked(entry, number, plain)) for number, entry in enumerate(entries, start=1)]


def _checked(entry: Any, number: int, data: Mapping[str, Any]) -> dict[str, Any]:
    if not isinstance(entry, dict) or not entry:
        raise InputError(f"record {number}: {SETTING}", entry, "a map of settings, such as {path: a.csv}")
    own = [name for name in data if name not in COMMON]
    for name in entry:
        if name not in own:
            allowed = f"one of {', '.join(own)}"
            hint = f"{name} is the same for all records" if name in COMMON else suggestion(str(name), own)
            raise InputError(f"record {number}: {SETTING}", name, allowed, hint)
    return dict(entry)


@contextmanager
def of_record(number: int, records: int) -> Iterator[None]:
    """Errors say which of several records they are about, within the block; records are counted from 1."""
    try:
        yield
    except InputError as error:
        if records == 1:
            raise
        raise InputError(f"record {number}: {error.setting}", error.value, error.allowed, error.hint) from None


def check_records(
    problem: JointProblem, estimator: TrainedNetwork, baseline: Estimator | None, validation: Validation
) -> None:
    """Refuse what has one record at a time, where there are several.

    Raises:
        InputError: Naming the setting.
    """
    if len(problem) == 1:
        return
    several = f"with the {len(problem)} records of {SETTING}"
    if not estimator.solves_records:
        allowed = f"spline or fourier, with training=gauss_newton and inferred weights, {several}"
        raise InputError("network", estimator.design.name, allowed, "other trainings have one record at a time")
    if baseline is not None and not baseline.solves_records:
        raise InputError("baseline", baseline.name, f"none {several}", "it smooths one record")
    if not validation.scores_records:
        raise InputError(
            "validation", validation.name, f"none or evidence {several}", "it withholds parts of one record"
        )
