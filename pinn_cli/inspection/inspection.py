"""A look at a record: its tables, what is odd about it, and what to do next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from pinn_cli.inspection.consistency import disagreements
from pinn_cli.inspection.proposal import as_typed, guessed, proposed_command
from pinn_cli.record.channels import clipped_percent, constant_percent
from pinn_cli.record.cross_spectra import CrossSpectra
from pinn_cli.record.record import MINIMUM_SAMPLES
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.record.signal import Peak, Sampling, Signal, find_peaks, spectra_of
from pinn_cli.record.spectrum import noise_level, signal_edges, visible_floor
from pinn_cli.settings.errors import InputError

COLUMNS = (
    "channel", "column", "quantity", "dof", "unit", "samples", "missing_percent", "longest_gap_s", "clipped_percent",
    "constant_percent", "mean", "rms", "least", "largest", "band_low_hz", "band_high_hz", "noise", "noise_is_visible",
    "snr_db",
)  # fmt: skip
PEAK_COLUMNS = (
    "frequency_hz", "frequency_std_hz", "damping_percent", "damping_std_percent", "coherence", "mode", "structure_hz",
    "difference_percent",
)  # fmt: skip
# Samples of a channel below which nothing is said of it but how many there are.
FEWEST = 16
# Parts of a channel that are worth a word, %; signal to noise below which it shows little, dB; and scatter of the steps
# in time, % of a step.
CLIPPED, CONSTANT, QUIET_DB, JITTER = 0.05, 5.0, 10.0, 3.0


def channel_table(signals: Sequence[Signal], sampling: Sampling) -> pd.DataFrame:
    """A row for each channel, columns `COLUMNS`.

    ``rms`` is about the mean. ``noise`` is the standard deviation of the white noise that the channel shows; where
    ``noise_is_visible`` is false, the noise lies below that. ``snr_db`` compares the two.
    """
    return pd.DataFrame([_row(signal, sampling) for signal in signals], columns=list(COLUMNS))


def _row(signal: Signal, sampling: Sampling) -> dict[str, object]:
    there = signal.values[np.isfinite(signal.values)]
    row: dict[str, object] = dict.fromkeys(COLUMNS, np.nan) | {
        "channel": signal.name, "column": signal.column, "quantity": signal.quantity, "dof": signal.place,
        "unit": signal.shown_unit, "samples": len(there),
        "missing_percent": 100.0 * (1.0 - len(there) / len(signal.values)),
        "longest_gap_s": longest_gap(signal.values, sampling),
    }  # fmt: skip
    if len(there) < FEWEST:
        return row
    row |= {
        "clipped_percent": clipped_percent(there), "constant_percent": constant_percent(there),
        "mean": float(there.mean()), "rms": float(there.std()), "least": float(there.min()),
        "largest": float(there.max()),
    }  # fmt: skip
    if np.ptp(there) == 0.0:
        return row
    values, step = sampling.on_regular(signal.values), 1.0 / sampling.rate
    low, high = signal_edges(values, step)
    visible = visible_floor(values, step)
    noise = noise_level(values, step) if visible is None else visible
    power = max(float(np.var(values)) - noise**2, 0.0)
    snr = 10.0 * np.log10(power / noise**2) if noise > 0.0 and power > 0.0 else np.nan
    return row | {
        "band_low_hz": low, "band_high_hz": high, "noise": noise, "noise_is_visible": visible is not None,
        "snr_db": snr,
    }  # fmt: skip


def longest_gap(values: np.ndarray, sampling: Sampling) -> float:
    """The longest time without a sample, s; 0 where every one is there."""
    there = np.flatnonzero(np.isfinite(values))
    if len(there) == 0:
        return sampling.duration
    edges = sampling.time[there]
    longest = float(np.max(np.diff(edges), initial=0.0))
    longest = max(longest, float(edges[0] - sampling.time[0]), float(sampling.time[-1] - edges[-1]))
    return longest if longest > 1.5 * sampling.step else 0.0


@dataclass(frozen=True, eq=False)
class Inspection:
    """What a look at a record found.

    Attributes:
        sampling: When its samples were taken.
        signals: Its columns.
        channels: See :func:`channel_table`.
        spectra: Of the columns that vary.
        peaks: Columns `PEAK_COLUMNS`; the last three compare with the structure, NaN without one.
        notes: Sentences about what is odd.
        command: What to type next, word by word.
    """

    sampling: Sampling
    signals: Sequence[Signal]
    channels: pd.DataFrame
    spectra: CrossSpectra[Signal]
    peaks: pd.DataFrame
    notes: Sequence[str]
    command: Sequence[str]


def inspect_record(
    signals: Sequence[Signal],
    time: np.ndarray,
    overrides: Sequence[str],
    frequencies: np.ndarray | None,
    measured: bool = True,
) -> Inspection:
    """Look at a record.

    Args:
        signals: Its columns, (N,) each.
        time: (N,), s, increasing.
        overrides: That the command was given, for the one that is proposed.
        frequencies: Natural frequencies of the structure, Hz; None: its parameters were not given.
        measured: Whether the columns are those of a file; else there is nothing to propose.

    Raises:
        InputError: There are too few samples, or no column varies.
    """
    if len(time) < MINIMUM_SAMPLES:
        allowed = f"a record of at least {MINIMUM_SAMPLES} samples"
        raise InputError("data.start, data.stop", f"{len(time)} samples", allowed)
    sampling = Sampling(time)
    guesses = _guesses(signals)
    converted = [signal.in_si() for signal in guesses or signals]
    signals = [signal for signal, _ in converted]
    alive = [signal for signal in signals if _varies(signal.values)]
    if not alive:
        raise InputError("data.path", f"{len(signals)} columns", "a record with a column that varies")
    channels = channel_table(signals, sampling)
    highest = float(np.nanmax(channels["band_high_hz"].to_numpy(dtype=float), initial=0.0))
    spectra = spectra_of(alive, sampling, highest)
    peaks = find_peaks(spectra)
    notes = ["what columns are is guessed by their names: see the command below"] if guesses else []
    notes += [note for _, note in converted if note]
    notes += [*_of_sampling(sampling), *_of_channels(channels), *disagreements(alive, sampling, spectra, peaks)]
    command = as_typed(overrides)
    if measured:
        command = proposed_command(overrides, signals, sampling, highest, len(peaks), frequencies is not None)
    return Inspection(sampling, signals, channels, spectra, peak_table(peaks, frequencies), notes, command)


def _guesses(signals: Sequence[Signal]) -> list[Signal]:
    """The same by their headers or names, where nobody has said what any of them is; empty where that says nothing."""
    if any(signal.quantity for signal in signals):
        return []
    found = [guessed(signal) for signal in signals]
    return found if any(signal.quantity in RESPONSE_QUANTITIES for signal in found) else []


def peak_table(peaks: Sequence[Peak], frequencies: np.ndarray | None) -> pd.DataFrame:
    """A row for each peak, beside the structure's nearest natural frequency; columns `PEAK_COLUMNS`."""
    rows = []
    known = np.zeros(0) if frequencies is None else frequencies[np.isfinite(frequencies) & (frequencies > 0.0)]
    for peak in peaks:
        row = dict.fromkeys(PEAK_COLUMNS, np.nan) | {
            "frequency_hz": peak.frequency, "frequency_std_hz": peak.frequency_std,
            "damping_percent": 100.0 * peak.damping, "damping_std_percent": 100.0 * peak.damping_std,
            "coherence": peak.coherence,
        }  # fmt: skip
        if len(known):
            nearest = int(np.argmin(np.abs(np.log(known / peak.frequency))))
            row |= {"mode": nearest + 1, "structure_hz": float(known[nearest])}
            row["difference_percent"] = 100.0 * (float(known[nearest]) / peak.frequency - 1.0)
        rows.append(row)
    return pd.DataFrame(rows, columns=list(PEAK_COLUMNS))


def _varies(values: np.ndarray) -> bool:
    there = values[np.isfinite(values)]
    return len(there) >= MINIMUM_SAMPLES and bool(np.ptp(there) > 0.0)


def _of_sampling(sampling: Sampling) -> list[str]:
    notes = []
    if holes := sampling.holes:
        longest = max(holes, key=lambda hole: hole[1] - hole[0])
        notes.append(
            f"{len(holes)} times rows are missing, at most {longest[1] - longest[0]:.4g} s, after {longest[0]:.6g} s"
        )
    if sampling.jitter_percent > JITTER:
        notes.append(f"steps in time scatter by {sampling.jitter_percent:.2g} % of a step")
    return notes


def _of_channels(channels: pd.DataFrame) -> list[str]:
    notes = []
    for row in channels.to_dict(orient="records"):
        name = row["channel"]
        if row["missing_percent"] > 0.0:
            notes.append(
                f"{row['missing_percent']:.2g} % of the samples of {name} are missing, at most"
                f" {row['longest_gap_s']:.3g} s at a time"
            )
        if row["least"] == row["largest"]:
            notes.append(f"{name} reads {row['mean']:g} throughout: a dead sensor?")
            continue
        if row["clipped_percent"] > CLIPPED:
            notes.append(f"{row['clipped_percent']:.2g} % of {name} sits at its largest or least value: clipped?")
        if row["constant_percent"] > CONSTANT:
            notes.append(f"{row['constant_percent']:.2g} % of {name} are repeated values: held, or a slower sensor?")
        if row["snr_db"] < QUIET_DB:
            notes.append(f"{name} is hardly above its noise: {row['snr_db']:.1f} dB")
    return notes
