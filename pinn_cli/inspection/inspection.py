"""A look at a record: its tables, what is odd about it, and what to do next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from pinn_cli.inspection.channel_table import channel_table
from pinn_cli.inspection.consistency import disagreements
from pinn_cli.inspection.proposal import as_typed, guessed, proposed_command
from pinn_cli.record.cross_spectra import CrossSpectra
from pinn_cli.record.peaks import Peak, find_peaks
from pinn_cli.record.record import MINIMUM_SAMPLES
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.record.signal import Sampling, Signal, spectra_of
from pinn_cli.settings.errors import InputError

PEAK_COLUMNS = (
    "frequency_hz", "frequency_std_hz", "damping_percent", "damping_std_percent", "coherence", "mode", "structure_hz",
    "difference_percent",
)  # fmt: skip
# Parts of a channel, %, that are worth a word; and signal to noise below which it shows little.
CLIPPED, CONSTANT, QUIET_DB, JITTER = 0.05, 5.0, 10.0, 3.0


@dataclass(frozen=True, eq=False)
class Inspection:
    """What a look at a record found.

    Attributes:
        sampling: When its samples were taken.
        signals: Its columns.
        channels: From `pinn_cli.inspection.channel_table`.
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
