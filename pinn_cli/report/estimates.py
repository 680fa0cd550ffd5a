"""What was estimated, with its deviation and where known its truth: numbers, and histories at every place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pinn_cli.record.record import Record
from pinn_cli.record.response import GROUND, QUANTITIES, UNITS
from pinn_cli.report.results import Results
from pinn_cli.system.quantities import CONNECTION_FORCE, SUPPORT
from pinn_cli.training.central_interval import HALF_WIDTH_90


@dataclass(frozen=True, eq=False)
class Estimates:
    """P numbers of one kind; NaN where something is not known.

    Attributes:
        names: (P,), what each is called.
        estimate, std: (P,), in the unit of the numbers; their intervals are those of normal distributions.
        true: (P,).
    """

    names: tuple[str, ...]
    estimate: np.ndarray
    std: np.ndarray
    true: np.ndarray

    @property
    def interval(self) -> np.ndarray:
        """(2, P), the central 90 % interval."""
        half = HALF_WIDTH_90 * self.std
        return np.stack((self.estimate - half, self.estimate + half))


def error_percent(estimate: np.ndarray, true: np.ndarray) -> np.ndarray:
    """100 |estimate - true| / |true|, as in the paper's tables; NaN where the truth is zero or unknown."""
    with np.errstate(divide="ignore", invalid="ignore"):
        error: np.ndarray = np.where(true != 0.0, 100.0 * np.abs(estimate - true) / np.abs(true), np.nan)
    return error


@dataclass(frozen=True, eq=False)
class Histories:
    """One quantity at C places over N times.

    Attributes:
        name: Of the quantity in ``response.nc``: ``displacement``, ``connection_force``.
        axis: What the places are: ``dof``, ``connection``, ``support``; "" of the ground, which is one.
        places: (C,), their names, or their numbers from 1.
        time: (N,), s.
        found: Source to values (N, C): the ``estimate``, its deviation ``std``, what is ``true``, what was
            ``observed``, what a ``free_run`` makes of it, and so on; a source that there is not is left out.
    """

    name: str
    axis: str
    places: tuple[str, ...]
    time: np.ndarray
    found: Mapping[str, np.ndarray]

    @property
    def unit(self) -> str:
        """Of the values, SI."""
        return {**UNITS, "drift": UNITS["displacement"]}[self.name]

    @property
    def words(self) -> str:
        """What people call the quantity."""
        special = {GROUND: "ground acceleration", CONNECTION_FORCE: "internal force"}
        return special.get(self.name) or (f"{SUPPORT[self.name]} of the support" if self.name in SUPPORT else self.name)

    def of(self, source: str) -> np.ndarray:
        """(N, C), NaN where there is none."""
        found = self.found.get(source)
        return np.full((len(self.time), len(self.places)), np.nan) if found is None else found

    def peaks(self, source: str = "estimate") -> tuple[np.ndarray, np.ndarray]:
        """Largest absolute value at every place and its sample, each (C,)."""
        values = self.of(source)
        sample = np.argmax(np.abs(values), axis=0)
        return np.abs(values[sample, np.arange(values.shape[1])]), sample

    def beside(self, **found: np.ndarray | None) -> Histories:
        """The same with further sources, those that are not None."""
        return replace(self, found={**self.found, **{name: x for name, x in found.items() if x is not None}})


def dof_histories(results: Results) -> list[Histories]:
    """Motion and force of every DOF: estimated, true where known at any DOF, and observed."""
    estimate, record = results.estimate, results.record
    places, out = tuple(record.dof_name(i) for i in range(record.ndof)), []
    for name in QUANTITIES:
        true = getattr(results.truth.response, name)
        own = Histories(name, "dof", places, record.time, {})
        found = {"estimate": getattr(estimate.response, name), "std": getattr(estimate.std, name)}
        known = {"true": true if np.isfinite(true).any() else None, "observed": observed(record, name)}
        out.append(own.beside(**found, **known))
    return out


def ground_history(results: Results) -> Histories | None:
    """The ground's acceleration; None where nobody knows of any."""
    estimate, record, truth = results.estimate, results.record, results.truth.response
    sources = {"estimate": estimate.response, "std": estimate.std, "true": truth}
    moved = {source: getattr(response, GROUND) for source, response in sources.items()}
    found = {source: x[:, None] for source, x in moved.items() if x is not None}
    if record.ground_acceleration is not None:
        found["observed"] = observed(record, GROUND)
    return Histories(GROUND, "", ("ground",), record.time, found) if found else None


def support_histories(results: Results) -> list[Histories]:
    """The motion of supports, where they move: estimated and observed."""
    estimate, record, out = results.estimate, results.record, []
    for order, name in enumerate(SUPPORT):
        moved = {"estimate": estimate.response.supports, "std": estimate.std.supports}
        found = {source: x[:, order] for source, x in moved.items() if x is not None}
        if name in record.supports:
            found["observed"] = observed(record, name)
        if found:
            out.append(Histories(name, "support", tuple(record.support_names), record.time, found))
    return out


def observed(record: Record, quantity: str) -> np.ndarray:
    """(N, C), what sensors measured; NaN where there is none, and where one has no sample."""
    # A force that is known to be zero is 0 in the record; nobody has measured it.
    shown = np.where(record.sensors(quantity), record.histories(quantity), np.nan)
    return np.where(record.missing[quantity], np.nan, shown) if quantity in record.missing else shown
