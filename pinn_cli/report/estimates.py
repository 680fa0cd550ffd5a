"""What was estimated, with its deviation and where known its truth: numbers, and histories at every place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pinn_cli.record.record import Record
from pinn_cli.record.response import GROUND, QUANTITIES, UNITS
from pinn_cli.report.results import Results
from pinn_cli.system.quantities import SUPPORT
from pinn_cli.training.central_interval import HALF_WIDTH_90
from pinn_cli.training.estimate import Estimate


@dataclass(frozen=True, eq=False)
class Estimates:
    """P numbers of one kind; NaN where something is not known.

    Attributes:
        names: (P,), what each is called.
        estimate, std: (P,), in the unit of the numbers.
        lower_90, upper_90: (P,), the central 90 % interval.
        true: (P,).
    """

    names: tuple[str, ...]
    estimate: np.ndarray
    std: np.ndarray
    lower_90: np.ndarray
    upper_90: np.ndarray
    true: np.ndarray

    @classmethod
    def gaussian(cls, names: tuple[str, ...], estimate: np.ndarray, std: np.ndarray, true: np.ndarray) -> Estimates:
        """With the intervals of normal distributions."""
        half = HALF_WIDTH_90 * std
        return cls(names, estimate, std, estimate - half, estimate + half, true)

    @property
    def error_percent(self) -> np.ndarray:
        """(P,), see :func:`error_percent`."""
        return error_percent(self.estimate, self.true)


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
        words: The same for people: ``internal force``.
        unit: SI.
        axis: What the places are: ``dof``, ``connection``, ``support``; "" of the ground, which is one.
        places: (C,), their names, or their numbers from 1.
        time: (N,), s.
        found: Source to values (N, C): the ``estimate``, its deviation ``std``, what is ``true``, what was
            ``observed``, what a ``free_run`` makes of it, and so on; a source that there is not is left out.
    """

    name: str
    words: str
    unit: str
    axis: str
    places: tuple[str, ...]
    time: np.ndarray
    found: Mapping[str, np.ndarray]

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
        return replace(self, found={**self.found, **_there(found)})


def dof_histories(results: Results) -> list[Histories]:
    """Motion and force of every DOF: estimated, true where known at any DOF, and observed."""
    estimate, record, truth = results.estimate, results.record, results.truth.response
    places = tuple(record.dof_name(i) for i in range(record.ndof))
    return [
        Histories(quantity, quantity, UNITS[quantity], "dof", places, record.time, _there(sources))
        for quantity in QUANTITIES
        for true in [getattr(truth, quantity)]
        for sources in [
            {
                **_estimated(estimate, quantity),
                "true": true if np.isfinite(true).any() else None,
                "observed": observed(record, quantity),
            }
        ]
    ]


def ground_history(results: Results) -> Histories | None:
    """The ground's acceleration; None where nobody knows of any."""
    record, truth = results.record, results.truth.response
    sources = {**_estimated(results.estimate, GROUND), "true": truth.ground_acceleration}
    found = {name: x[:, None] for name, x in sources.items() if x is not None}
    if record.ground_acceleration is not None:
        found["observed"] = observed(record, GROUND)
    words = GROUND.replace("_", " ")
    return Histories(GROUND, words, UNITS[GROUND], "", ("ground",), record.time, found) if found else None


def support_histories(results: Results) -> list[Histories]:
    """The motion of supports, where they move: estimated and observed."""
    estimate, record = results.estimate, results.record
    out = []
    for order, (name, quantity) in enumerate(SUPPORT.items()):
        moved = {"estimate": estimate.response.supports, "std": estimate.std.supports}
        found = {source: x[:, order] for source, x in moved.items() if x is not None}
        if name in record.supports:
            found["observed"] = observed(record, name)
        if found:
            words, places = f"{quantity} of the support", tuple(record.support_names)
            out.append(Histories(name, words, UNITS[name], "support", places, record.time, found))
    return out


def observed(record: Record, quantity: str) -> np.ndarray:
    """(N, C), what sensors measured; NaN where there is none, and where one has no sample."""
    # A force that is known to be zero is 0 in the record; nobody has measured it.
    shown = np.where(record.sensors(quantity), record.histories(quantity), np.nan)
    return np.where(record.missing[quantity], np.nan, shown) if quantity in record.missing else shown


def _estimated(estimate: Estimate, quantity: str) -> dict[str, np.ndarray | None]:
    return {"estimate": getattr(estimate.response, quantity), "std": getattr(estimate.std, quantity)}


def _there(found: Mapping[str, np.ndarray | None]) -> dict[str, np.ndarray]:
    return {name: values for name, values in found.items() if values is not None}
