"""The record as its sensors turned out to be calibrated."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from pinn_cli.record.between_samples import BandLimited
from pinn_cli.record.gauge import Gauge
from pinn_cli.record.record import Record
from pinn_cli.record.response import QUANTITIES, Response
from pinn_cli.system.quantities import CALIBRATION_UNITS, GROUND
from pinn_cli.training.estimate import Estimate, ParameterEstimate


def as_calibrated(record: Record, estimate: Estimate) -> Record:
    """The record whose columns show what gauges felt, with the gains, offsets, drifts and delays that were found.

    A report and a verdict compare an estimate with this; see :func:`beside`. A record without gauges stays as it is.
    """
    return beside(record, estimate.of_motion or estimate.parameters, estimate.response, estimate.left)


def beside(
    record: Record,
    parameters: Iterable[ParameterEstimate],
    response: Response,
    left: Mapping[str, np.ndarray] | None = None,
) -> Record:
    """The record as a response is compared with it: the response's columns with what gauges leave of it.

    What a gauge leaves unexplained at one of its own times stands at the record's nearest one; where it has no sample,
    the column shows the response, and `Record.missing` says so.

    Args:
        record: Whose gauges they are.
        parameters: With the numbers of their calibration.
        response: (N, n) each.
        left: See :attr:`Estimate.left`; of those that are not in it, between the response's samples there is nothing
            above their Nyquist frequency.
    """
    found, told = by_sensor(parameters), left or {}

    def shown(gauge: Gauge) -> tuple[np.ndarray, np.ndarray]:
        place, inside = sample_places(gauge, found[gauge.name], record.time)
        own = told[gauge.name] if gauge.name in told else _left(gauge, found[gauge.name], record.time, response)
        inside &= np.isfinite(own)
        column, there = gauge.felt_in(response).copy(), np.zeros(len(record.time), dtype=bool)
        column[place[inside]] += own[inside]
        there[place[inside]] = True
        return column, there

    return with_gauges(record, shown)


def as_felt(record: Record, parameters: Iterable[ParameterEstimate]) -> Record:
    """The record whose columns show what gauges felt, for a run that takes its inputs from them.

    Where a gauge has no sample its column is no measurement.
    """
    found = by_sensor(parameters)

    def shown(gauge: Gauge) -> tuple[np.ndarray, np.ndarray]:
        place, inside = sample_places(gauge, found[gauge.name], record.time)
        there = np.zeros(len(record.time), dtype=bool)
        there[place[inside]] = True
        return gauge.history(record.time, found[gauge.name]), there

    return with_gauges(record, shown)


def with_gauges(record: Record, shown: Callable[[Gauge], tuple[np.ndarray, np.ndarray]]) -> Record:
    """The record whose gauges' columns show something else; the same without gauges.

    Args:
        record: Whose gauges they are.
        shown: From a gauge to its column (N,), and to where it has a sample there, (N,) bool.
    """
    if not record.gauges:
        return record
    columns: dict[str, Any] = {quantity: getattr(record, quantity).copy() for quantity in QUANTITIES}
    columns[GROUND] = None if record.ground_acceleration is None else record.ground_acceleration[:, None].copy()
    missing = {quantity: np.zeros(values.shape, bool) for quantity, values in columns.items() if values is not None}
    beside = {}
    for gauge in record.gauges:
        column, there = shown(gauge)
        if gauge.dof is None:
            beside[gauge.name] = column, there
        else:
            columns[gauge.quantity][:, gauge.dof], missing[gauge.quantity][:, gauge.dof] = column, ~there
    if columns[GROUND] is not None:
        columns[GROUND] = columns[GROUND][:, 0]
    return replace(record, **columns, missing=missing, beside=beside)


def by_sensor(parameters: Iterable[ParameterEstimate]) -> defaultdict[str, dict[str, float]]:
    """Name of a sensor to the numbers of its calibration that were found, by kind."""
    found: defaultdict[str, dict[str, float]] = defaultdict(dict)
    for one in parameters:
        if one.kind in CALIBRATION_UNITS:
            found[one.parameter.label][one.kind] = one.estimate
    return found


def sample_places(gauge: Gauge, found: Mapping[str, float], time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(J,), the place of each sample among the times (N,), and (J,) bool, those that are within them."""
    felt_at = gauge.calibrated(found)[0]
    step = (time[-1] - time[0]) / (len(time) - 1)
    # All samples of one sensor move alike: where it is late by half a step, each still has a place of its own.
    late = int(np.rint((gauge.time[0] - felt_at[0]) / step))
    place = np.rint((gauge.time - time[0]) / step).astype(np.int64) - late
    inside = (place >= 0) & (place < len(time)) & (felt_at >= time[0]) & (felt_at <= time[-1])
    return place, inside


def _left(gauge: Gauge, found: dict[str, float], time: np.ndarray, response: Response) -> np.ndarray:
    """(J,), measured minus what a gauge feels in a response; NaN outside."""
    (felt_at, felt), (place, inside) = gauge.calibrated(found), sample_places(gauge, found, time)
    expected, out = gauge.passed(time, gauge.felt_in(response, found), found), np.full(len(felt), np.nan)
    left = felt[inside] - BandLimited(time, expected)(felt_at[inside])
    if gauge.filter_order:
        decays = gauge.decays(time, found)[place[inside]]
        left = left - decays @ np.linalg.lstsq(decays, left)[0]
    out[inside] = left
    return out
