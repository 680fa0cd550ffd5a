"""A look at a record: its tables, what is odd about it, beside a structure that was given, and what to do next."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from pinn_cli.inspection.modes import ModalRecord
from pinn_cli.inspection.proposal import Look, Said, proposed_settings
from pinn_cli.inspection.report import InspectionReport
from pinn_cli.record.checks import GRAVITY, CheckedRecord, clipped_percent, constant_percent
from pinn_cli.record.cross_spectra import CrossSpectra
from pinn_cli.record.identification.lines import RecordMode
from pinn_cli.record.record import Record
from pinn_cli.record.response import QUANTITIES
from pinn_cli.record.signal import Sampling, Signal, guessed, number_of, spectra_of
from pinn_cli.record.spectrum import noise_level, signal_edges, visible_floor
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import InputError
from pinn_cli.system.quantities import FORCE, GROUND
from pinn_cli.system.structure import Structure
from pinn_cli.verdict.causes import causes

CHANNEL_COLUMNS = (
    "channel", "column", "quantity", "dof", "unit", "samples", "missing_percent", "longest_gap_s", "clipped_percent",
    "constant_percent", "mean", "rms", "least", "largest", "band_low_hz", "band_high_hz", "noise", "noise_is_visible",
    "snr_db",
)  # fmt: skip
PEAK_COLUMNS = (
    "frequency_hz", "frequency_std_hz", "damping_percent", "damping_std_percent", "explained", "mode", "structure_hz",
    "difference_percent",
)  # fmt: skip
# Samples of a channel below which nothing is said of it but how many there are.
FEWEST_OF_CHANNEL = 16
# Part of a channel that is worth a word, %; signal to noise below which it shows little, dB; scatter of the steps in
# time, % of a step.
CONSTANT, QUIET_DB, JITTER = 5.0, 10.0, 3.0

# A force that is mostly below this part of its deviation comes in blows; the median of a normal distribution's size.
BLOWS, NORMAL_MEDIAN = 0.2, 0.6745
# Two sensors of one DOF agree within this part; less coherent than this, they say nothing of each other.
AGREE, COHERENT = 0.1, 0.5
# What an acceleration is of that which a displacement or velocity says, where one of the two is in another unit.
_RATIOS = {
    1.0 / GRAVITY: "the acceleration is in g?",
    1e3: "the acceleration is in mm/s^2?",
    1e2: "the acceleration is in cm/s^2?",
    1e-3: "the other one is in mm or mm/s?",
    1e-2: "the other one is in cm or cm/s?",
    1e-6: "the other one is in um or um/s?",
    1e-3 / GRAVITY: "the acceleration is in g, the other one in mm or mm/s?",
}


def channel_table(signals: Sequence[Signal], sampling: Sampling) -> pd.DataFrame:
    """A row for each channel, columns `CHANNEL_COLUMNS`.

    ``rms`` is about the mean. ``noise`` is the standard deviation of the white noise that the channel shows; where
    ``noise_is_visible`` is false, the noise lies below that. ``snr_db`` compares the two.
    """
    return pd.DataFrame([_row(signal, sampling) for signal in signals], columns=list(CHANNEL_COLUMNS))


def _row(signal: Signal, sampling: Sampling) -> dict[str, object]:
    there = signal.there
    row: dict[str, object] = dict.fromkeys(CHANNEL_COLUMNS, np.nan) | {
        "channel": signal.name, "column": signal.column, "quantity": signal.quantity, "dof": signal.place,
        "unit": signal.shown_unit, "samples": len(there),
        "missing_percent": 100.0 * (1.0 - len(there) / len(signal.values)),
        "longest_gap_s": longest_gap(signal.values, sampling),
    }  # fmt: skip
    if len(there) < FEWEST_OF_CHANNEL:
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
    # A blow fills the spectrum, and would pass for noise there: of short ones noise is what is between them.
    between = float(np.median(np.abs(values - np.median(values)))) / NORMAL_MEDIAN
    is_blows = signal.quantity == "force" and between < BLOWS * float(values.std())
    visible = between if is_blows else visible_floor(values, step)
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


def inspect_record(
    signals: Sequence[Signal], time: np.ndarray, said: Said, frequencies: np.ndarray | None
) -> InspectionReport:
    """Look at a record's columns, (N,) each, at increasing times (N,), s.

    ``said`` is what the command was given, for the one that is proposed; ``frequencies`` are natural ones of the
    structure, Hz, None where its parameters were not given.

    Raises:
        InputError: There are too few samples, or no column varies.
    """
    sampling = Sampling(time)
    guesses, notes = guessed(signals)
    forces = {signal.column for signal in guesses if signal.quantity == "force"}
    unplaced = [signal.column for signal in signals if signal.column in forces and number_of(signal) is None]
    converted = [signal.in_si() for signal in guesses or signals]
    signals = [signal for signal, _ in converted]
    alive = [signal for signal in signals if signal.varies]
    if not alive:
        raise InputError("data.path", f"{len(signals)} columns", "a record with a column that varies")
    channels = channel_table(signals, sampling)
    highest = float(np.nanmax(channels["band_high_hz"].to_numpy(dtype=float), initial=0.0))
    spectra = spectra_of(alive, sampling, highest)
    modal = ModalRecord.of_alive(alive, sampling)
    peaks = modal.modes
    if len(unplaced) == 1 and len(spectra.acting) == 1 and len({sensor.place for sensor in spectra.sensors}) > 1:
        place, note = _driven(spectra, peaks)
        acts = {signal.column: replace(signal, place=place) for signal in signals if signal.column in unplaced}
        signals, alive = ([acts.get(signal.column, signal) for signal in some] for some in (signals, alive))
        spectra = replace(spectra, acting=[acts.get(signal.column, signal) for signal in spectra.acting])
        channels = channels.assign(channel=[s.name for s in signals], dof=[s.place for s in signals])
        notes = [*notes, note]
    checked = CheckedRecord([signal for signal in signals if len(signal.there) >= FEWEST_OF_CHANNEL], sampling)
    faults = [fault for i in range(len(checked.signals)) for fault in checked.faults_of(i)]
    notes += [note for _, note in converted if note]
    notes += [
        *_of_sampling(sampling),
        *_of_channels(channels),
        *(fault.text for fault in faults),
        *_of_one_dof(spectra),
        *modal.remarks,
    ]
    notes += [*_opposed(spectra, peaks), *_against_the_ground(spectra, peaks)]
    look = Look(
        signals, sampling, highest, len(peaks), frequencies is not None, bool(guesses),
        [of.signal.column for of in faults if of.kind == "offset" and of.signal.quantity == "acceleration"],
        [signal.column for signal, note in converted if note],
    )  # fmt: skip
    settings, remarks = proposed_settings(said, look)
    table = peak_table(peaks, frequencies)
    return InspectionReport(sampling, signals, channels, spectra, table, tuple(notes), said, tuple(settings), remarks)


def peak_table(peaks: Sequence[RecordMode], frequencies: np.ndarray | None) -> pd.DataFrame:
    """A row for each peak, beside the structure's nearest natural frequency; columns `PEAK_COLUMNS`."""
    rows = []
    natural = np.zeros(0) if frequencies is None else frequencies[np.isfinite(frequencies) & (frequencies > 0.0)]
    for peak in peaks:
        row = dict.fromkeys(PEAK_COLUMNS, np.nan) | {
            "frequency_hz": peak.frequency, "frequency_std_hz": peak.frequency_std,
            "damping_percent": 100.0 * peak.damping, "damping_std_percent": 100.0 * peak.damping_std,
            "explained": peak.explained,
        }  # fmt: skip
        if len(natural):
            nearest = int(np.argmin(np.abs(np.log(natural / peak.frequency))))
            row |= {"mode": nearest + 1, "structure_hz": float(natural[nearest])}
            row["difference_percent"] = 100.0 * (float(natural[nearest]) / peak.frequency - 1.0)
        rows.append(row)
    return pd.DataFrame(rows, columns=list(PEAK_COLUMNS))


def _of_sampling(sampling: Sampling) -> Iterator[str]:
    if holes := sampling.holes:
        start, end = max(holes, key=lambda hole: hole[1] - hole[0])
        yield f"{len(holes)} times rows are missing, at most {end - start:.4g} s, after {start:.6g} s"
    if sampling.jitter_percent > JITTER:
        yield f"steps in time scatter by {sampling.jitter_percent:.2g} % of a step"


def _of_channels(channels: pd.DataFrame) -> Iterator[str]:
    """What may be no fault, and is worth a question before a run; of the noise a run knows more."""
    for row in channels.to_dict(orient="records"):
        name = row["channel"]
        if row["missing_percent"] > 0.0:
            missing, gap = row["missing_percent"], row["longest_gap_s"]
            yield f"{missing:.2g} % of the samples of {name} are missing, at most {gap:.3g} s at a time"
        # Between blows a load cell may read the same throughout.
        is_pulses = row["quantity"] == "force" and row["noise"] == 0.0
        if row["constant_percent"] > CONSTANT and row["least"] < row["largest"] and not is_pulses:
            yield f"{row['constant_percent']:.2g} % of {name} are repeated values: held, or a slower sensor?"
        if row["snr_db"] < QUIET_DB:
            doubt = "" if row["noise_is_visible"] else ", if its flat spectrum is noise, and not what white forces do"
            yield f"{name} is hardly above its noise: {row['snr_db']:.1f} dB{doubt}"


def _of_one_dof(spectra: CrossSpectra[Signal]) -> Iterator[str]:
    """An acceleration against the displacement or velocity of the same DOF."""
    for i, a in enumerate(spectra.sensors):
        for j, other in enumerate(spectra.sensors):
            if a.quantity != "acceleration" or other.order == a.order or a.place != other.place:
                continue
            ratio, coherence = _ratio(spectra, j, i)
            if coherence < COHERENT:
                yield f"{a.name} and {other.name} have little in common (coherence {coherence:.2f})"
            elif abs(ratio - 1.0) > AGREE:
                yield f"{a.name} is {ratio:.3g} times what {other.name} says{_cause(ratio)}"


def _ratio(spectra: CrossSpectra[Signal], x: int, a: int) -> tuple[float, float]:
    """What an acceleration is of a signal's derivative, by least squares over the band of both; and their coherence."""
    cross, power_x, power_a = spectra.cross[:, a, x], spectra.power[:, x], spectra.power[:, a]
    turn = (1j * spectra.omega) ** (spectra.orders[a] - spectra.orders[x])
    with np.errstate(divide="ignore", invalid="ignore"):
        coherence = np.nan_to_num(np.abs(cross) ** 2 / (power_x * power_a))
    seen = (coherence > 0.5) & (spectra.frequency > 0)
    if not seen.any():
        return np.nan, float(np.max(coherence[1:], initial=0.0))
    along = np.sum((np.conj(turn) * cross)[seen].real)
    size = np.sum((np.abs(turn) ** 2 * power_x)[seen])
    return float(along / size), float(np.average(coherence[seen], weights=power_a[seen]))


def _cause(ratio: float) -> str:
    if ratio < 0.0:
        sign = "; the sign of one of them is wrong?"
        return sign if abs(-ratio - 1.0) < AGREE else f"{sign}{_cause(-ratio).replace(';', ' and', 1)}"
    unit = next((cause for expected, cause in _RATIOS.items() if abs(ratio / expected - 1.0) < AGREE), "")
    return f"; {unit}" if unit else "; a gain or a unit is wrong?"


def _opposed(spectra: CrossSpectra[Signal], peaks: Sequence[RecordMode]) -> Iterator[str]:
    """At a resonance, an accelerometer where the force acts moves ahead of it by a quarter period, never behind."""
    for j, force in enumerate(spectra.acting):
        for i, sensor in enumerate(spectra.sensors):
            if force.quantity != "force" or sensor.place != force.place or not sensor.quantity:
                continue
            ahead = _ahead(spectra, peaks, i, j)
            if ahead and np.mean(ahead) < -0.5:
                yield f"{sensor.name} moves against {force.name}: the sign of one of them is wrong?"


def _driven(spectra: CrossSpectra[Signal], peaks: Sequence[RecordMode]) -> tuple[str, str]:
    """The DOF that a force acts on: the one that moves ahead of it at resonances; and what is to be said of that."""
    force, means = spectra.acting[0], []
    for i, sensor in enumerate(spectra.sensors):
        ahead = _ahead(spectra, peaks, i, 0)
        means.append((float(np.mean(ahead)) if ahead else 0.0, sensor.place))
    unsaid, (most, place) = f"which DOF {force.column!r} acts on is not in its name", max(means)
    if most > 0.5 and all(mean < most - 0.5 for mean, other in means if other != place):
        return place, f"{unsaid}: DOF {place} is taken, the only one that moves with it at resonances"
    return force.place, f"{unsaid}, nor seen: DOF {force.place} is taken"


def _ahead(spectra: CrossSpectra[Signal], peaks: Sequence[RecordMode], sensor: int, force: int) -> list[float]:
    """Sine of the phase of an acceleration over a force, at every resonance that the two have in common.

    Over the lines about it: those below and above are out of phase, and between two of them the phase turns.
    """
    sines, f = [], spectra.frequency
    for peak in peaks:
        k = int(np.argmin(np.abs(f - peak.frequency)))
        if spectra.coherence[k, sensor] > max(COHERENT, spectra.chance_coherence()):
            about = np.abs(f - peak.frequency) <= max(1.5 * f[1], 2.0 * peak.damping * peak.frequency)
            turned = (1j * spectra.omega[about]) ** (2 - spectra.sensors[sensor].order)
            response = np.sum(spectra.response[about, sensor, force] * turned)
            sines.append(float(response.imag / abs(response)))
    return sines


def _against_the_ground(spectra: CrossSpectra[Signal], peaks: Sequence[RecordMode]) -> Iterator[str]:
    """Far below the first natural frequency the structure moves as the ground does."""
    if [signal.quantity for signal in spectra.acting] != [GROUND] or not peaks:
        return
    f, first = spectra.frequency, peaks[0].frequency
    for i, sensor in enumerate(spectra.sensors):
        slow = (f > 0) & (f < first / 4.0) & (spectra.coherence[:, i] > 0.8)
        if sensor.quantity != "acceleration" or slow.sum() < 3:
            continue
        expected = 1.0 / (1.0 - (f[slow] / first) ** 2)
        gain = float(np.median(spectra.response[slow, i, 0].real / expected))
        if abs(gain - 1.0) > 2.0 * AGREE:
            yield (
                f"far below {first:.3g} Hz {sensor.name} is {gain:.3g} times the ground's{_cause(gain)}"
                " (or data.frame=relative)"
            )


def contradictions(structure: Structure, signals: Sequence[Signal], sampling: Sampling) -> list[str]:
    """Sentences of what the verdict would look for: a unit, a sign, a place, a mass; none where the structure fits.

    All parameters of the structure are given. Columns whose place is no DOF are left out.
    """
    columns = {quantity: np.full((len(sampling.regular), structure.ndof), np.nan) for quantity in QUANTITIES}
    unforced, ground = np.ones(structure.ndof, dtype=bool), None
    for signal in (signal for signal in signals if signal.varies):
        values = sampling.on_regular(signal.values)
        dof = int(signal.place) - 1 if signal.place.isdigit() else -1
        if signal.quantity == GROUND:
            ground = values - values.mean()
        elif signal.quantity in columns and 0 <= dof < structure.ndof:
            columns[signal.quantity][:, dof] = values - values.mean()
            unforced[dof] &= signal.quantity != FORCE
    columns[FORCE] = np.nan_to_num(columns[FORCE])
    if not any(np.isfinite(columns[quantity]).any() for quantity in columns if quantity != FORCE):
        return []
    u, v, a, f = (columns[quantity] for quantity in QUANTITIES)
    record = Record(sampling.regular, u, v, a, f, unforced, ground_acceleration=ground)
    return [finding.text for finding in causes(Problem(structure, record), structure, structure)]
