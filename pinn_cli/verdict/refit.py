"""Unknown stiffnesses once more, from nothing but spectra: where a fault has drawn the estimate away, causes need them.

The structure without its nonlinearity is fitted to the shape of every channel's power spectrum over that of the force:
a channel in another unit, with a gain, a sign or a delay has the same shape. A few steps on the histories follow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import least_squares

from pinn_cli.record.channels import Channel, channels
from pinn_cli.record.spectrum import periodogram, record_band
from pinn_cli.system.modes import Modes
from pinn_cli.verdict.linear_response import decays, linear_response

if TYPE_CHECKING:
    from pinn_cli.record.record import Record
    from pinn_cli.system.parameters import Parameter
    from pinn_cli.system.structure import Structure

# Common factors of the unknown stiffnesses that are tried, from where the highest mode is at the end of the record's
# band (force and sensors may end below it, noise above), and how many of them are followed.
SCALES, FOLLOWED = np.geomspace(0.03, 100.0, 85), 4
BINS, LEAST_LINES, NEIGHBOURS = 80, 3, 7
# Wider than the band that the channels fill: a spectrum's end says where the last mode is.
BEYOND = 1.2
EVALUATIONS, POLISHING = 25, 8
MOST_SAMPLES = 4096


@dataclass(frozen=True, eq=False)
class Spectra:
    """Power of the force and of every channel, in bins of growing width.

    Attributes:
        seen: The channels.
        s: (K,), 1/s, of the lines.
        force: (K, n), square root of the force's power; forces on several DOFs count as independent.
        edges: First line of every bin.
        measured: (channels, bins).
        floor: (channels, bins), the noise in each.
        levels: Whether the level counts, or the shape only.
    """

    seen: list[Channel]
    s: np.ndarray
    force: np.ndarray
    edges: np.ndarray
    measured: np.ndarray
    floor: np.ndarray
    levels: bool

    @classmethod
    def of(cls, record: Record, seen: list[Channel], levels: bool) -> Spectra:
        """Of a record."""
        frequency, _ = periodogram(record.time, record.step)
        top = min(BEYOND * record_band(record), 0.9 * frequency[-1])
        used = np.flatnonzero((frequency <= top) & (frequency > 1.5 / record.duration))
        edges = np.unique(np.geomspace(1, len(used), BINS).astype(int) - 1)
        edges = edges[np.concatenate(([True], np.diff(edges) >= 1))]
        edges = edges[:: max(1, LEAST_LINES * len(edges) // max(1, len(used)))]

        def power(x: np.ndarray) -> np.ndarray:
            return periodogram(x, record.step)[1][used]

        force = np.sqrt(np.column_stack([power(record.force[:, dof]) for dof in range(record.ndof)]))
        measured = np.stack([np.add.reduceat(power(c.measured), edges) for c in seen])
        return cls(seen, 2j * np.pi * frequency[used], force, edges, measured, _floor(measured, edges), levels)

    def misfit(self, modes: Modes) -> np.ndarray:
        """Logarithm of predicted over measured power, (channels * bins,), without each channel's level."""
        forced = np.flatnonzero(self.force.any(axis=0))
        power = np.zeros((modes.shapes.shape[0], len(self.s)))
        for dof in forced:
            modal = modes.pushed[:, dof, None] / (self.s - modes.poles[:, None])
            power += np.abs(modes.shapes @ modal * self.force[:, dof]) ** 2
        out = []
        for c, measured, floor in zip(self.seen, self.measured, self.floor, strict=True):
            predicted = np.add.reduceat(power[c.dof] * np.abs(self.s) ** (2 * c.order), self.edges)
            difference = np.log(measured) - np.log(np.maximum(predicted, 1e-300))
            level = 0.0 if self.levels else float(np.median(difference[measured > 3.0 * floor]))
            out.append(np.log(predicted * np.exp(level) + floor) - np.log(measured))
        return np.concatenate(out)


def _floor(measured: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """(channels, bins): noise power of each bin, from the least mean of a few bins in a row."""
    lines = np.diff(edges, append=2 * edges[-1] - edges[-2])
    density = uniform_filter1d(measured / lines, min(NEIGHBOURS, len(edges)), axis=1, mode="nearest")
    return density.min(axis=1, keepdims=True) * lines


def refitted(
    structure: Structure, record: Record, free: Sequence[Parameter], excused: Sequence[str], levels: bool
) -> Structure | None:
    """The linear chain whose free parameters fit the record best; None where there is nothing to fit.

    Args:
        structure: With the parameters that are held, and with a start for the free ones, which may be decades off
            together.
        record: Whose forces are all known.
        free: Which parameters move; all of them are positive.
        excused: Names of channels that are left out.
        levels: Whether the channels' levels are trusted (a mass is in doubt), or their shapes only (a channel is).
    """
    seen = channels(record, excused=excused)
    if not seen or not free:
        return None
    spectra = Spectra.of(record, seen, levels)
    own = structure.linearised()
    first = np.log([max(float(own.parameters[p.kind][p.index]), 1e-300) for p in free])
    stiff = np.array([float(p.kind == "k") for p in free])

    def misfit(x: np.ndarray) -> np.ndarray:
        return np.nan_to_num(spectra.misfit(Modes.of(_moved(own, free, x))), nan=50.0, posinf=50.0, neginf=-50.0)

    first += stiff * np.log(_stiffening(own, record))
    tried = [first + stiff * np.log(scale) for scale in (SCALES if stiff.any() else (1.0,))]
    starts = _deepest([float(np.sum(np.abs(misfit(x)))) for x in tried])[:FOLLOWED]
    found = [least_squares(misfit, tried[start], loss="soft_l1", max_nfev=EVALUATIONS).x for start in starts]
    polished = [_polished(record, seen, own, free, x, levels) for x in found]
    return _moved(own, free, min(polished, key=lambda pair: pair[0])[1])


def _stiffening(own: Structure, record: Record) -> float:
    """The factor on every stiffness that puts the highest natural frequency at the end of the record's band."""
    highest = float(np.nanmax(Modes.of(own).natural_frequencies))
    return float(record_band(record) / highest) ** 2 if highest > 0 else 1.0


def _deepest(costs: Sequence[float]) -> list[int]:
    """Positions of the local minima, the deepest first."""
    around = np.concatenate(([np.inf], costs, [np.inf]))
    minima = [i for i, cost in enumerate(costs) if cost <= around[i] and cost <= around[i + 2]]
    return sorted(minima, key=lambda i: costs[i])


def _moved(own: Structure, free: Sequence[Parameter], x: np.ndarray) -> Structure:
    """With the free parameters at exp(x)."""
    return own.with_values(dict(zip(free, np.exp(np.clip(x, -200.0, 200.0)).tolist(), strict=True)))


def _polished(
    record: Record, seen: list[Channel], own: Structure, free: Sequence[Parameter], x: np.ndarray, levels: bool
) -> tuple[float, np.ndarray]:
    """A few least-squares steps on the histories, every channel weighed by how well it fits at first.

    Returns:
        Sum over the channels of the logarithm of what is left of each, and the parameters.
    """
    part = record.until(min(len(record.time), MOST_SAMPLES))
    begin = Modes.of(_moved(own, free, x))
    measured, bases = [], []
    for c in seen:
        basis = decays(begin, c, part)
        y = c.measured[: len(part.time)] - np.mean(c.measured)
        y = y - basis @ (basis.T @ y)
        measured.append(y / np.linalg.norm(y))
        bases.append(basis)

    def residuals(at: np.ndarray) -> list[np.ndarray]:
        response, out = linear_response(Modes.of(_moved(own, free, at)), part), []
        for c, y, basis in zip(seen, measured, bases, strict=True):
            p = c.of(response)
            p = p - basis @ (basis.T @ p)
            scale = np.linalg.norm(c.measured[: len(p)] - np.mean(c.measured))
            out.append(y - p * (1 / scale if levels else float(p @ y) / float(p @ p)))
        return out

    weights = [1.0 / (0.02 + float(r @ r)) for r in residuals(x)]

    def weighted(at: np.ndarray) -> np.ndarray:
        return np.nan_to_num(np.concatenate([w * r for w, r in zip(weights, residuals(at), strict=True)]))

    x = np.asarray(least_squares(weighted, x, max_nfev=POLISHING).x)
    return float(sum(np.log(1e-4 + np.nan_to_num(float(r @ r), nan=1e9)) for r in residuals(x))), x
