"""Modes of several records of one structure, put together: some sensors stay in their places, others rove.

Every record is identified by itself. Its modes are paired with those of the others, and their shapes are scaled to each
other by the sensors that they have in common (post separate estimation re-scaling, PoSER: Reynders, Magalhaes, De Roeck
and Cunha, IMAC XXVII, 2009), all at once by weighted least squares (Au, Mechanical Systems and Signal Processing 25,
2011, 163):

    shape of record r at sensor s = scale_r * joined shape at s + error
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.stats import chi2

from pinn_cli.inspection.modes import ModalRecord, alike, names_of
from pinn_cli.record.identification.lines import RecordMode

if TYPE_CHECKING:
    from pinn_cli.record.signal import Signal

# Modes of two records are the same where their frequencies differ by this part, or by so many deviations, at most (a
# bridge's move by one or two per cent with the weather), and their shapes at common sensors are alike.
ALIKE_FREQUENCY, SAME_DEVIATIONS, ALIKE_SHAPE = 0.03, 3.0, 0.5
# Of a shape's largest entry, the least deviation that one counts with.
LEAST_DEVIATION = 1e-4
# Turns of least squares, and the change of a shape that ends them.
TURNS, SHAPE_SETTLED = 200, 1e-6


@dataclass(frozen=True, eq=False)
class Part:
    """A mode as one record shows it.

    Attributes:
        record: Number of the record, from 0.
        mode: Its number among the modes of the record, from 0.
        places: (S,), where the record's sensors stand among those of all records.
        shape: (S,), complex.
        noise: (S, S), covariance of the errors of the real parts.
    """

    record: int
    mode: int
    places: np.ndarray
    shape: np.ndarray
    noise: np.ndarray

    @cached_property
    def weights(self) -> np.ndarray:
        """(S,), one over the variances."""
        least = LEAST_DEVIATION * float(np.max(np.abs(self.shape)))
        return np.asarray(1.0 / np.maximum(np.diag(self.noise), least**2))


@dataclass(frozen=True, eq=False)
class JoinedMode:
    """A mode of all records that show it.

    Attributes:
        parts: Of it, by record.
        shape: (P,), complex, at the sensors of all records; the largest is one; NaN where no record shows it.
        shape_std: (P,), of its real part.
        scales: (parts,), of the records' shapes: one's own is its scale times the joined one.
        scale_std: (parts,), their relative deviations.
        mac: (parts,), of the record's own shape and the joined one, at the record's sensors.
        mode: With frequency and damping ratio of all records.
        agreement: (2,), probability that chance makes frequencies, and damping ratios, of the records differ as much;
            NaN with one record.
    """

    parts: Sequence[Part]
    shape: np.ndarray
    shape_std: np.ndarray
    scales: np.ndarray
    scale_std: np.ndarray
    mac: np.ndarray
    mode: RecordMode
    agreement: tuple[float, float]


@dataclass(frozen=True, eq=False)
class JoinedModes:
    """The modes of several records, at all their sensors.

    Attributes:
        records: As they were identified.
        sensors: P of them, each once.
        names: Of these.
        joined: By frequency.
        unconnected: Numbers, from 0, of records that have no sensor in common with those before them.
    """

    records: Sequence[ModalRecord]
    sensors: Sequence[Signal]
    names: Sequence[str]
    joined: Sequence[JoinedMode]
    unconnected: Sequence[int]

    @classmethod
    def of(cls, records: Sequence[ModalRecord]) -> JoinedModes:
        """Of records of one structure."""
        by_name: dict[str, Signal] = {}
        names = names_of(records)
        for of_record, record in zip(names, records, strict=True):
            by_name |= {name: s for name, s in zip(of_record, record.sensors, strict=True) if name not in by_name}
        all_names = sorted(by_name, key=lambda name: (not name.isdecimal(), int(name) if name.isdecimal() else 0))
        places = [np.array([all_names.index(name) for name in of_record]) for of_record in names]
        groups: list[list[Part]] = []
        order, unconnected = _order(places, [len(record.modes) for record in records])
        for r in order:
            parts = [
                Part(r, i, places[r], shape, 0.5 * records[r].noise(i).real)
                for i, shape in enumerate(records[r].shapes)
            ]
            _sort_in(groups, parts, records, len(all_names))
        joined = [_joined(sorted(group, key=lambda part: part.record), records, len(all_names)) for group in groups]
        joined.sort(key=lambda joined_mode: joined_mode.mode.frequency)
        return cls(records, [by_name[name] for name in all_names], all_names, joined, unconnected)

    @property
    def modes(self) -> Sequence[RecordMode]:
        """By frequency."""
        return [joined_mode.mode for joined_mode in self.joined]

    @property
    def shapes(self) -> np.ndarray:
        """(M, P), see :attr:`JoinedMode.shape`."""
        return np.array([joined_mode.shape for joined_mode in self.joined]).reshape(-1, len(self.sensors))

    def shape_std(self, number: int) -> np.ndarray:
        """(P,), of the real part of a shape."""
        return self.joined[number].shape_std

    @property
    def opposed(self) -> Iterator[tuple[int, int, float]]:
        """Numbers, from 0, of modes of different records at one frequency, whose shapes differ; and their MAC."""
        for i, j in combinations(range(len(self.joined)), 2):
            first, second = self.joined[i], self.joined[j]
            distance = abs(np.log(first.mode.frequency / second.mode.frequency))
            common = np.isfinite(first.shape) & np.isfinite(second.shape)
            mac = alike(first.shape[common], second.shape[common])
            twice = {part.record for part in first.parts} & {part.record for part in second.parts}
            if distance < ALIKE_FREQUENCY and mac < ALIKE_SHAPE and not twice:
                yield i, j, mac

    def peak(self, number: int) -> tuple[float, float]:
        """The mean of the records' peaks near a mode, Hz, and the least MAC of their shapes; NaN: no peak."""
        peaks = np.array([self.records[part.record].peak(part.mode) for part in self.joined[number].parts])
        there = peaks[np.isfinite(peaks[:, 0])]
        return (float(there[:, 0].mean()), float(there[:, 1].min())) if len(there) else (np.nan, np.nan)


def _order(places: Sequence[np.ndarray], modes: Sequence[int]) -> tuple[list[int], list[int]]:
    """Records, each with sensors in common with those before it as far as there are any; and those that have none."""
    rest = sorted(range(len(places)), key=lambda r: -modes[r])
    order, unconnected, seen = [rest.pop(0)], [], set[int]()
    while rest:
        seen |= set(places[order[-1]].tolist())
        following = max(rest, key=lambda r: len(seen & set(places[r].tolist())))
        if not seen & set(places[following].tolist()):
            unconnected.append(following)
        rest.remove(following)
        order.append(following)
    return order, sorted(unconnected)


def _sort_in(groups: list[list[Part]], parts: Sequence[Part], records: Sequence[ModalRecord], places: int) -> None:
    """Put the modes of one more record to those that they are the same as; the others begin groups of their own."""
    far = 1e3
    cost = np.full((len(parts), len(groups)), far)
    for j, group in enumerate(groups):
        theirs, so_far = _mode(group[0], records), _assembled(group, places)[0]
        for i, part in enumerate(parts):
            mode, there = _mode(part, records), np.isfinite(so_far[part.places])
            distance = abs(np.log(mode.frequency / theirs.frequency))
            deviation = float(mode.covariance[0, 0] + theirs.covariance[0, 0]) ** 0.5
            reach = max(ALIKE_FREQUENCY, SAME_DEVIATIONS * deviation)
            mac = alike(part.shape[there], so_far[part.places][there])
            if there.any() and distance < reach and not mac < ALIKE_SHAPE:
                cost[i, j] = distance / reach + 1.0 - np.nan_to_num(mac, nan=1.0)
    pairs = {i: j for i, j in zip(*linear_sum_assignment(cost), strict=True) if cost[i, j] < far}
    for i, part in enumerate(parts):
        if i in pairs:
            groups[pairs[i]].append(part)
        else:
            groups.append([part])


def _mode(part: Part, records: Sequence[ModalRecord]) -> RecordMode:
    return records[part.record].modes[part.mode]


def _joined(parts: Sequence[Part], records: Sequence[ModalRecord], places: int) -> JoinedMode:
    shape, scales = _assembled(parts, places)
    shape_std, scale_std = _deviations(parts, shape, scales)
    modes = [_mode(part, records) for part in parts]
    logarithms = np.log([[mode.frequency, mode.damping] for mode in modes])
    precisions = np.linalg.inv([mode.covariance for mode in modes])
    covariance = np.linalg.inv(precisions.sum(axis=0))
    mean = covariance @ np.einsum("iab,ib->a", precisions, logarithms)
    variances = np.array([np.diag(mode.covariance) for mode in modes])
    # Each quantity by itself, about its own mean.
    means = np.sum(logarithms / variances, axis=0) / np.sum(1.0 / variances, axis=0)
    squares, free = np.sum((logarithms - means) ** 2 / variances, axis=0), len(parts) - 1
    wider = np.sqrt(np.maximum(squares / max(free, 1), 1.0))  # Birge, Physical Review 40 (1932) 207
    agreement = chi2.sf(squares, free) if free else np.full(2, np.nan)
    noise = np.diag(2.0 * shape_std**2)
    f, damping = np.exp(mean)
    explained = min(mode.explained for mode in modes)
    mode = RecordMode(float(f), float(damping), covariance * np.outer(wider, wider), shape, noise, explained)
    mac = np.array([alike(part.shape, shape[part.places]) for part in parts])
    return JoinedMode(parts, shape, shape_std, scales, scale_std, mac, mode, (float(agreement[0]), float(agreement[1])))


def _assembled(parts: Sequence[Part], places: int) -> tuple[np.ndarray, np.ndarray]:
    """The shape (P,) of all parts, NaN where there is none, and the scale of each: alternating least squares."""
    shape = np.full(places, np.nan, dtype=complex)
    rest = sorted(parts, key=lambda part: -len(part.places))
    scaled: list[tuple[Part, complex]] = []
    while rest:  # a start: one after the other, by what is known
        part = max(rest, key=lambda part: int(np.isfinite(shape[part.places]).sum()))
        rest.remove(part)
        scale = _scale(part, shape) if scaled else 1.0 + 0.0j
        new = part.places[~np.isfinite(shape[part.places])]
        shape[new] = part.shape[~np.isfinite(shape[part.places])] / (scale or 1.0)
        scaled.append((part, scale))
    for _ in range(TURNS):
        scales = [_scale(part, shape) for part in parts]
        upper, lower = np.zeros(places, dtype=complex), np.zeros(places)
        for part, scale in zip(parts, scales, strict=True):
            upper[part.places] += part.weights * np.conj(scale) * part.shape
            lower[part.places] += part.weights * abs(scale) ** 2
        fresh = np.where(lower > 0.0, upper / np.where(lower > 0.0, lower, 1.0), np.nan)
        fresh = fresh / fresh[np.nanargmax(np.abs(fresh))]
        moved = float(np.nanmax(np.abs(fresh - shape)))
        shape = fresh
        if moved < SHAPE_SETTLED:
            break
    seen = shape[np.isfinite(shape)]
    shape = shape * np.exp(-0.5j * np.angle(np.sum(seen**2)))
    shape = shape / shape.real[np.nanargmax(np.abs(shape.real))]
    return shape, np.array([_scale(part, shape) for part in parts])


def _scale(part: Part, shape: np.ndarray) -> complex:
    """What a shape (P,) is multiplied by to be nearest to a record's."""
    there = np.isfinite(shape[part.places])
    of_part, of_all, weights = part.shape[there], shape[part.places][there], part.weights[there]
    return complex(np.sum(weights * of_all.conj() * of_part) / max(np.sum(weights * np.abs(of_all) ** 2), 1e-300))


def _deviations(parts: Sequence[Part], shape: np.ndarray, scales: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of the real part of a shape (P,), whose largest is one, and of the scales, relative: to first order.

    Where the records' shapes differ by more than their errors explain, so much larger.
    """
    seen, largest = np.flatnonzero(np.isfinite(shape)), int(np.nanargmax(np.abs(shape.real)))
    column = {int(place): i for i, place in enumerate(place for place in seen if place != largest)}
    columns, rows = len(column) + len(parts), sum(len(part.places) for part in parts)
    slopes, noise, residual, at = np.zeros((rows, columns)), np.zeros((rows, rows)), np.zeros(rows), 0
    for i, (part, scale) in enumerate(zip(parts, scales, strict=True)):
        block = slice(at, at + len(part.places))
        for row, place in enumerate(part.places, start=at):
            if place in column:
                slopes[row, column[place]] = abs(scale)
        slopes[block, len(column) + i] = shape.real[part.places]
        noise[block, block] = part.noise
        turned = part.shape * np.exp(-1j * np.angle(scale))
        residual[block] = turned.real - abs(scale) * shape.real[part.places]
        at += len(part.places)
    root = np.sqrt(np.concatenate([part.weights for part in parts]))
    inverse = np.linalg.pinv(slopes * root[:, None], rcond=1e-12) * root
    rest = (np.eye(rows) - slopes @ inverse) * root[:, None]
    expected = float(np.trace(rest @ noise @ rest.T))
    usual = expected > 1e-9 * rows and rows > columns
    wider = max(float(np.sum((root * residual) ** 2)) / expected, 1.0) if usual else 1.0
    std = np.sqrt(wider * np.maximum(np.diag(inverse @ noise @ inverse.T), 0.0))
    deviations = np.full(len(shape), np.nan)
    deviations[largest] = 0.0
    deviations[list(column)] = std[: len(column)]
    return deviations, std[len(column) :] / np.maximum(np.abs(scales), 1e-300)
