"""Modes that a record shows by itself: poles that stay, each then by the lines around it, the clearest first.

A pole that is there at many orders need not be a mode: noise has such poles, and so have machines. Each is tried
against the lines of the whole record's spectrum, beside the modes that were found before it, and kept if chance does
not explain it, if it is wider than a line, and if it is determined.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pinn_cli.record.identification.fits import PowerFit, ResponseFit
from pinn_cli.record.identification.lines import Lines, Pole, RecordMode
from pinn_cli.record.identification.subspace import MOST_DAMPED, Stabilisation, assurance, stabilisation

# Logarithm of the probability that chance makes a mode; part of the motion at its peak that is its own, at least.
CHANCE, LEAST_OF_ITS_OWN = -16.0, 0.5
# Deviations of the logarithms of a frequency that is determined, and of a damping ratio of which anything is known;
# lines in a half-power width, at least.
MOST_UNCERTAIN, MOST_UNCERTAIN_DAMPING, NARROWEST = 0.02, 1.2, 0.5
# Modes nearer than this part of their half-power width are one, unless their shapes differ.
ONE, OTHER_SHAPE = 1.0, 0.5
# So many poles are tried, and periods of the record are needed.
MOST_TRIED, FEWEST_PERIODS = 60, 8.0


@dataclass(frozen=True, eq=False)
class Identified:
    """What a record shows.

    Attributes:
        modes: By frequency.
        machines: Frequencies of steady lines that look like modes, Hz.
        stabilisation: All poles.
        tones: Of every input, see :class:`pinn_cli.record.identification.lines.Lines`.
    """

    modes: Sequence[RecordMode]
    machines: Sequence[float]
    stabilisation: Stabilisation
    tones: Sequence[np.ndarray]


def identify(outputs: np.ndarray, inputs: np.ndarray, step: float) -> Identified:
    """Find the modes of a record with a step, s: of sensors (N, S), and what acts (N, F) as far as it was measured."""
    poles = stabilisation(outputs, inputs, step)
    lines = Lines.of(_levelled(outputs), _levelled(inputs), step)
    tried = []
    for f, damping, shape in poles.clusters():
        candidate = Pole(f, max(damping, 1e-4))
        if f * lines.duration > FEWEST_PERIODS:
            tried.append((_fit(lines, candidate, (), shape).gain(), candidate, shape))
    tried = sorted(tried, key=lambda candidate: candidate[0])[:MOST_TRIED]
    accepted: list[tuple[Pole, np.ndarray]] = []
    lone: list[Pole] = []
    for gain, candidate, shape in tried:
        neighbours = [*(pole for pole, _ in accepted), *lone]
        if gain > CHANCE or any(_same(candidate, shape, *other) for other in accepted):
            continue
        fit = _fit(lines, candidate, neighbours, shape)
        if neighbours and fit.gain() > CHANCE:
            continue
        fitted = fit.solve()
        if fitted is None:
            continue
        pole = Pole(fitted.frequency, fitted.damping)
        if _is_line(fit, pole, lines):
            lone.append(pole)
        elif _holds(fitted, candidate, lines) and not any(_same(pole, fitted.shape, *other) for other in accepted):
            accepted.append((pole, shape))
    modes = []
    for pole, shape in accepted:
        neighbours = [*(other for other, _ in accepted if other is not pole), *lone]
        fitted = _fit(lines, pole, neighbours, shape).solve()
        if fitted is not None and _holds(fitted, pole, lines):
            modes.append(fitted)
    modes.sort(key=lambda mode: mode.frequency)
    return Identified(modes, sorted(pole.frequency for pole in lone), poles, lines.tones)


def _levelled(values: np.ndarray) -> np.ndarray:
    """Without the line from the first samples to the last: where they differ, that step is in every line."""
    few = max(1, len(values) // 500)
    first, last = values[:few].mean(axis=0), values[-few:].mean(axis=0)
    return np.asarray(values - first - np.linspace(0.0, 1.0, len(values))[:, None] * (last - first))


def _fit(lines: Lines, pole: Pole, neighbours: Sequence[Pole], shape: np.ndarray) -> ResponseFit | PowerFit:
    if lines.inputs.shape[1]:
        return ResponseFit(lines, pole, neighbours)
    return PowerFit(lines, pole, neighbours, shape)


def _same(pole: Pole, shape: np.ndarray, other: Pole, its_shape: np.ndarray) -> bool:
    width = ONE * max(pole.damping * pole.frequency, other.damping * other.frequency)
    alike = len(shape) == 1 or assurance(shape[None], its_shape[None])[0, 0] > OTHER_SHAPE
    return abs(pole.frequency - other.frequency) < width and bool(alike)


def _is_line(fit: ResponseFit | PowerFit, pole: Pole, lines: Lines) -> bool:
    """Whether it is a sine: as narrow as a line, or as steady."""
    if not isinstance(fit, PowerFit):
        return False
    return 2.0 * pole.damping * pole.frequency * lines.duration < NARROWEST or fit.is_steady


def _holds(mode: RecordMode, start: Pole, lines: Lines) -> bool:
    """Whether it is a vibration, determined, and has not run away from where it was looked for."""
    variance, of_damping = np.diag(mode.covariance)
    width = max(start.damping, mode.damping) * start.frequency + 2.0 / lines.duration
    return bool(
        np.isfinite(mode.covariance).all()
        and abs(mode.frequency - start.frequency) < 2.0 * width
        and 0.0 < variance**0.5 < MOST_UNCERTAIN
        and 0.0 < of_damping**0.5 < MOST_UNCERTAIN_DAMPING
        and mode.damping < MOST_DAMPED
        and 2.0 * mode.damping * mode.frequency * lines.duration > NARROWEST
        and mode.explained > LEAST_OF_ITS_OWN
    )
