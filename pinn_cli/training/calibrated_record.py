"""The record as its sensors turned out to be calibrated."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np

from pinn_cli.record.between_samples import BandLimited
from pinn_cli.record.channel import Channel
from pinn_cli.record.record import Record
from pinn_cli.record.response import Response
from pinn_cli.system.quantities import CALIBRATION_UNITS
from pinn_cli.training.estimate import Estimate, ParameterEstimate


def as_calibrated(record: Record, estimate: Estimate) -> Record:
    """The record whose columns show what sensors felt, with the gains, offsets, drifts and delays that were found.

    A report and a verdict compare an estimate with this; see :func:`compared_record`.
    """
    return compared_record(record, estimate.of_motion or estimate.parameters, estimate.response, estimate.left)


def as_run(record: Record, estimate: Estimate) -> Record:
    """The same with the numbers of the estimate's own parameters, where its motion goes with those of another story.

    What acts on the structure, and what its sensors show, when it runs free: the offset of a load cell belongs to the
    structure's parameters as they do to each other.
    """
    if estimate.of_motion is None:
        return as_calibrated(record, estimate)
    return compared_record(record, estimate.parameters, estimate.response)


def compared_record(
    record: Record,
    parameters: Iterable[ParameterEstimate],
    response: Response,
    residuals: Mapping[str, np.ndarray] | None = None,
) -> Record:
    """The record as a response is compared with it: the response's columns with what calibrated channels leave of it.

    What a channel leaves unexplained at one of its own times stands at the record's nearest one; where it has no
    sample, the column shows the response, and `Channel.gaps` says so.

    Args:
        record: Whose channels they are.
        parameters: With the numbers of their calibration.
        response: (N, n) each.
        residuals: See :attr:`Estimate.left`; of those that are not in it, between the response's samples there is
            nothing above their Nyquist frequency.
    """
    numbers, given = by_sensor(parameters), residuals or {}

    def as_column(channel: Channel) -> Channel:
        place, inside = sample_places(channel, numbers[channel.key], record.time)
        residual = given.get(channel.key)
        if residual is None:
            residual = _residual(channel, numbers[channel.key], record.time, response)
        inside &= np.isfinite(residual)
        column, gaps = channel.of(response).copy(), np.ones(len(record.time), dtype=bool)
        column[place[inside]] += residual[inside]
        gaps[place[inside]] = False
        return channel.at(record.time, column, gaps)

    return _with_columns(record, as_column)


def as_felt(record: Record, parameters: Iterable[ParameterEstimate]) -> Record:
    """The record whose columns show what its calibrated channels felt, for a run that takes its inputs from them.

    Where a channel has no sample its column is no measurement.
    """
    numbers = by_sensor(parameters)

    def as_column(channel: Channel) -> Channel:
        place, inside = sample_places(channel, numbers[channel.key], record.time)
        gaps = np.ones(len(record.time), dtype=bool)
        gaps[place[inside]] = False
        return channel.at(record.time, channel.history(record.time, numbers[channel.key]), gaps)

    return _with_columns(record, as_column)


def _with_columns(record: Record, as_column: Callable[[Channel], Channel]) -> Record:
    columns = tuple(as_column(channel) for channel in record.calibrated)
    return replace(record.showing(columns), corrected=columns) if columns else record


def by_sensor(parameters: Iterable[ParameterEstimate]) -> defaultdict[str, dict[str, float]]:
    """Name of a sensor to the numbers of its calibration that were found, by kind."""
    numbers: defaultdict[str, dict[str, float]] = defaultdict(dict)
    for estimate in parameters:
        if estimate.kind in CALIBRATION_UNITS:
            numbers[estimate.parameter.label][estimate.kind] = estimate.estimate
    return numbers


def sample_places(channel: Channel, numbers: Mapping[str, float], time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(J,), the place of each sample among the times (N,), and (J,) bool, those that are within them."""
    felt_at = channel.corrected_samples(numbers)[0]
    step = (time[-1] - time[0]) / (len(time) - 1)
    # All samples of one sensor move alike: where it is late by half a step, each still has a place of its own.
    late = int(np.rint((channel.time[0] - felt_at[0]) / step))
    place = np.rint((channel.time - time[0]) / step).astype(np.int64) - late
    inside = (place >= 0) & (place < len(time)) & (felt_at >= time[0]) & (felt_at <= time[-1])
    return place, inside


def _residual(channel: Channel, numbers: dict[str, float], time: np.ndarray, response: Response) -> np.ndarray:
    """(J,), measured minus what a channel feels in a response; NaN outside."""
    (felt_at, samples), (place, inside) = channel.corrected_samples(numbers), sample_places(channel, numbers, time)
    expected, out = channel.shown_of(response, numbers), np.full(len(samples), np.nan)
    residual = samples[inside] - BandLimited(time, expected)(felt_at[inside])
    if channel.filter_order:
        decays = channel.decays(time, numbers)[place[inside]]
        residual = residual - decays @ np.linalg.lstsq(decays, residual)[0]
    out[inside] = residual
    return out
