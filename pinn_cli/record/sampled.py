"""From the channels of a file to columns of a record, and to more where a column cannot hold what they say."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pinn_cli.record.between_samples import FIRST_ORDER_HOLD, Intersample, held_by_lines, samples_per_line
from pinn_cli.record.channel import Channel
from pinn_cli.record.clock import TIME_TOLERANCE, Clock
from pinn_cli.record.data_channels import DataChannel
from pinn_cli.record.record import MINIMUM_SAMPLES
from pinn_cli.record.spectrum import BandPass, decimate
from pinn_cli.settings.errors import InputError
from pinn_cli.system.quantities import FORCE, SUPPORT

log = logging.getLogger(__name__)

# A channel with fewer of its samples than this is told.
NEARLY_EMPTY = 0.1


@dataclass(frozen=True, eq=False)
class Sampled:
    """The channels of a window.

    Attributes:
        time: (N,), s, uniform: the times of the columns.
        columns: Quantity and number, counted from 0, to samples (N,); some as they are believed to be.
        calibrated, intersample, assumed, band: See :class:`pinn_cli.record.record.Record`.
    """

    time: np.ndarray
    columns: Mapping[tuple[str, int], np.ndarray]
    calibrated: tuple[Channel, ...]
    intersample: Intersample
    assumed: bool
    band: BandPass | None


def sampled(
    channels: Sequence[DataChannel],
    clock: Clock,
    window: tuple[int, int],
    thinned: int | BandPass,
    connections: Sequence[str] = (),
    intersample: str | None = None,
) -> Sampled:
    """The channels of a window of a file.

    Where all times are even, a channel without gaps whose calibration is known is a column, and nothing else.

    Args:
        channels: Of the file.
        clock: When its samples were taken.
        window: First row, and the row after the last.
        thinned: Every so manieth sample is kept, after an anti-alias filter; or what leaves a band alone, which takes
            samples beyond the window where the file has them.
        connections: Names of the structure's connections.
        intersample: See :class:`pinn_cli.record.measured_data.MeasuredData`.

    Raises:
        InputError: A cell that is no number, a channel with too few, a sensor that shows one value throughout; gaps
            where samples are to be filtered.
    """
    window = window if isinstance(thinned, int) else reached(thinned, window, len(clock.time))
    first, last = window
    hints = clock.table.hints
    channels = [c.in_unit(hints[c.column].unit if c.column in hints else "") for c in channels]
    values = [clock.table.numbers(channel.column, first, last) for channel in channels]
    for channel, column in zip(channels, values, strict=True):
        _check_samples(channel, column)
    time, even = clock.regular(first, last)
    whole = [even and not np.isnan(column).any() for column in values]
    lines = _on_lines(channels, values, intersample, whole)
    values = [held_by_lines(column) if held else column for held, column in zip(lines, values, strict=True)]
    if thinned != 1:
        time, values = with_fewer(thinned, time, values, all(whole))
    placed = _placed(channels, time, values, even, connections)
    held: Intersample = "zero_order_hold" if intersample == "zero_order_hold" else "band_limited"
    assumed = intersample is None and not any(lines)
    return Sampled(*placed, held, assumed, thinned if isinstance(thinned, BandPass) else None)


def reached(band: BandPass, window: tuple[int, int], rows: int) -> tuple[int, int]:
    """Rows that a filter takes for those of a window, as far as the file has them; too few are refused."""
    first, last = max(0, window[0] - band.half), min(rows, window[1] + band.half)
    samples = -(-(last - first - 2 * band.half) // band.factor)
    if samples < MINIMUM_SAMPLES:
        allowed = f"a record of which its filter leaves {MINIMUM_SAMPLES} samples"
        hint = f"of {window[1] - window[0]} samples it leaves {max(samples, 0)}"
        raise InputError("data.band", f"a filter of {len(band.taps)} samples", allowed, hint)
    return first, last


def with_fewer(
    by: int | BandPass, time: np.ndarray, values: Sequence[np.ndarray], whole: bool
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Times (N,), s, and channels (N,) with fewer samples, see :func:`sampled`; refused where one is missing or off."""
    setting, given = ("data.decimate", by) if isinstance(by, int) else ("data.band", "a band")
    if not whole:
        nothing, whose = (1, "an anti-alias") if isinstance(by, int) else ("null", "its")
        allowed = f"{nothing} where samples are missing or uneven"
        raise InputError(setting, given, allowed, f"{whose} filter needs every sample")
    columns = np.stack(values, axis=1)
    if isinstance(by, int):
        return time[::by], list(decimate(columns, by).T)
    filtered = by.filtered(columns)
    return time[by.half :: by.factor][: len(filtered)], list(filtered.T)


def _on_lines(
    channels: Sequence[DataChannel], values: Sequence[np.ndarray], intersample: str | None, whole: Sequence[bool]
) -> list[bool]:
    """Which channels of what acts go on between samples by lines; said of missing or uneven ones it is refused."""
    acts = [channel.sensor.is_input for channel in channels]
    if intersample == FIRST_ORDER_HOLD:
        for channel, here, complete in zip(channels, acts, whole, strict=True):
            if here and not complete:
                hint = f"samples of {channel.column!r} are missing or uneven"
                raise InputError("data.intersample", intersample, "null or band_limited here", hint)
        return acts
    if intersample is not None:
        return [False] * len(values)
    on_lines = [
        here and complete and samples_per_line(column) > 1
        for here, complete, column in zip(acts, whole, values, strict=True)
    ]
    for channel in (channel for channel, held in zip(channels, on_lines, strict=True) if held):
        text = "%s lies on straight lines: taken with data.intersample=%s; say band_limited if it does not"
        log.warning(text, channel.setting, FIRST_ORDER_HOLD)
    return on_lines


def _placed(
    channels: Sequence[DataChannel], time: np.ndarray, values: list[np.ndarray], even: bool, connections: Sequence[str]
) -> tuple[np.ndarray, dict[tuple[str, int], np.ndarray], tuple[Channel, ...]]:
    """Times (N,), columns and calibrated channels, see :class:`Sampled`."""
    columns: dict[tuple[str, int], np.ndarray] = {}
    rest: list[tuple[DataChannel, np.ndarray]] = []
    axis = time if even else _even_axis(time, values)
    for channel, column in zip(channels, values, strict=True):
        place, there = channel.sensor.place, ~np.isnan(column)
        whole = there.sum() == len(axis) and np.abs(time[there] - axis).max() <= TIME_TOLERANCE * (axis[1] - axis[0])
        if channel.is_plain and place not in columns and whole:
            columns[place] = channel.with_samples(axis, column[there], connections, fills=True).corrected_samples()[1]
        elif channel.sensor.quantity in SUPPORT:
            allowed = "one channel of a kind for a support, with every sample at even times"
            raise InputError(channel.setting, repr(channel.column), allowed)
        else:
            rest.append((channel, column))
    calibrated: list[Channel] = []
    for channel, column in rest:
        there = ~np.isnan(column)
        sampled = channel.with_samples(time[there], column[there], connections, channel.sensor.place not in columns)
        calibrated.append(sampled)
        if sampled.is_column:
            columns[sampled.place] = sampled.history(axis)
        _tell(channel, column, time)
    return axis, columns, tuple(calibrated)


def _even_axis(time: np.ndarray, values: list[np.ndarray]) -> np.ndarray:
    """(N,), even times from first to last: those of the fastest channel where they are even, else as close."""
    fastest = min((time[~np.isnan(column)] for column in values), key=lambda times: float(np.median(np.diff(times))))
    step = float(np.median(np.diff(fastest)))
    if np.abs(fastest - np.linspace(fastest[0], fastest[-1], len(fastest))).max() <= TIME_TOLERANCE * step:
        step = float((fastest[-1] - fastest[0]) / (len(fastest) - 1))
        before, after = int((fastest[0] - time[0]) / step), int((time[-1] - fastest[-1]) / step)
        axis = np.linspace(fastest[0] - before * step, fastest[-1] + after * step, len(fastest) + before + after)
    else:
        axis = np.linspace(time[0], time[-1], max(MINIMUM_SAMPLES, round((time[-1] - time[0]) / step) + 1))
    text = "the times are uneven: every sample is used at its own time, and results come at %d even ones"
    log.warning(text, len(axis))
    return axis


def _check_samples(channel: DataChannel, column: np.ndarray) -> None:
    there = column[~np.isnan(column)]
    if len(there) < MINIMUM_SAMPLES:
        allowed = f"a channel with at least {MINIMUM_SAMPLES} numbers in the window"
        raise InputError(channel.setting, repr(channel.column), allowed, f"it has {len(there)}")
    # A response sensor that reads one value throughout has seen nothing; a force may well be zero.
    if channel.sensor.quantity != FORCE and np.ptp(there) == 0.0:
        own = channel.setting.removeprefix("data.")
        listed = own.rpartition(".")[0] or own
        hint = f"every sample of it is {there[0]:g}: a dead sensor? Leave it out of data.{listed}"
        raise InputError(channel.setting, repr(channel.column), "a column that varies", hint)


def _tell(channel: DataChannel, column: np.ndarray, time: np.ndarray) -> None:
    """Warn of a channel that is nearly empty, counted by its own rate."""
    there = np.flatnonzero(~np.isnan(column))
    step = float(np.median(np.diff(time[there])))
    share = len(there) * step / (time[-1] - time[0] + step)
    if share < NEARLY_EMPTY:
        text = "%s is nearly empty: %d samples, %.2g %% of what its own rate would give"
        log.warning(text, channel.setting, len(there), 100.0 * share)
