"""Structures of the family `nonlinear` with two to five DOFs, and nobody measured the force."""

from __future__ import annotations

from dataclasses import replace
from itertools import count, islice
from typing import Any

from benchmarks.trust.case import Case
from benchmarks.trust.families import nonlinear

APART = 10_000  # from the seeds of that family


def draw(seed: int) -> Case:
    """The next one of at least two DOFs: what holds the only DOF on which an unknown force acts is not to be told."""
    (case,) = islice(filter(_of_several, map(nonlinear.draw, count(APART + 97 * seed))), 1)
    data: dict[str, Any] = dict(case.settings["data"])  # type: ignore[call-overload]
    data["force"] = dict.fromkeys(data["force"])
    records = {name: table.drop(columns="f") for name, table in case.records.items()}
    about, settings = f"{case.about}, nobody measured the force", case.settings | {"data": data}
    return replace(
        case, family="unmeasured_nonlinear", seed=seed, records=records, settings=settings, about=about
    )  # fmt: skip


def _of_several(case: Case) -> bool:
    return case.truth.displacement.shape[1] > 1
