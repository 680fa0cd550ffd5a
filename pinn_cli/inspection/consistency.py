"""Whether channels agree with each other: sign, size, offsets; each disagreement is a sentence."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from pinn_cli.record.cross_spectra import CrossSpectra
from pinn_cli.record.response import GROUND
from pinn_cli.record.signal import Peak, Sampling, Signal

# Two sensors of one DOF agree within this part; less coherent than this, they say nothing of each other.
AGREE, COHERENT = 0.1, 0.5
# An acceleration whose mean is more than this part of its rms has an offset; gravity is recognised within a fiftieth.
OFFSET, GRAVITY = 0.1, 9.80665
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


def disagreements(
    signals: Sequence[Signal], sampling: Sampling, spectra: CrossSpectra[Signal], peaks: Sequence[Peak]
) -> list[str]:
    """Sentences, of offsets first.

    Args:
        signals: Of the record.
        sampling: Of their values.
        spectra: Of the same signals.
        peaks: Of the record.
    """
    found = [*_offsets(signals, sampling), *_of_one_dof(spectra), *_opposed(spectra, peaks)]
    return [*found, *_against_the_ground(spectra, peaks)]


def _offsets(signals: Sequence[Signal], sampling: Sampling) -> Iterator[str]:
    for signal in signals:
        if signal.quantity not in ("acceleration", GROUND):
            continue
        there = signal.values[np.isfinite(signal.values)]
        mean, rms = float(there.mean()), float(there.std())
        gravity = next((g for g in (GRAVITY, 1.0) if abs(abs(mean) / g - 1.0) < 0.02), None)
        if gravity is not None and abs(mean) > rms:
            unit = "m/s^2" if gravity == GRAVITY else "g"
            yield f"the mean of {signal.name} is {mean:.4g}: gravity, in {unit}?"
        elif abs(mean) > OFFSET * rms:
            drift = abs(mean) * sampling.duration
            yield (
                f"the mean of {signal.name} is {mean:.3g}, {abs(mean) / rms:.0%} of its rms: integrated over the record"
                f" it is a velocity of {drift:.3g} that nobody had"
            )


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
    unit = next((cause for known, cause in _RATIOS.items() if abs(ratio / known - 1.0) < AGREE), "")
    return f"; {unit}" if unit else "; a gain or a unit is wrong?"


def _opposed(spectra: CrossSpectra[Signal], peaks: Sequence[Peak]) -> Iterator[str]:
    """At a resonance, an accelerometer where the force acts moves ahead of it by a quarter period, never behind."""
    for j, force in enumerate(spectra.acting):
        for i, sensor in enumerate(spectra.sensors):
            if force.quantity != "force" or sensor.place != force.place or not sensor.quantity:
                continue
            ahead = []
            for peak in peaks:
                k = int(np.argmin(np.abs(spectra.frequency - peak.frequency)))
                if spectra.coherence[k, i] > max(COHERENT, spectra.chance_coherence()):
                    response = spectra.response[k, i, j] * (1j * spectra.omega[k]) ** (2 - sensor.order)
                    ahead.append(float(response.imag / abs(response)))
            if ahead and np.mean(ahead) < -0.5:
                yield f"{sensor.name} moves against {force.name}: the sign of one of them is wrong?"


def _against_the_ground(spectra: CrossSpectra[Signal], peaks: Sequence[Peak]) -> Iterator[str]:
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
