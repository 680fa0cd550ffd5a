"""Modes of records (``pinn-run modes``), beside frequency-domain decomposition; and of several records, put together.

Of these some sensors stay in their places, others rove. Every record is identified by itself. Its modes are paired with
those of the others, and their shapes are scaled to each other by the sensors that they have in common (post separate
estimation re-scaling, PoSER: Reynders, Magalhaes, De Roeck and Cunha, IMAC XXVII, 2009), all at once by weighted least
squares (Au, Mechanical Systems and Signal Processing 25, 2011, 163):

    shape of record r at sensor s = scale_r * joined shape at s + error
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
import pandas as pd
from scipy.optimize import linear_sum_assignment
from scipy.stats import chi2

from pinn_cli.record.cross_spectra import CrossSpectra
from pinn_cli.record.identification.lines import RecordMode, deviations
from pinn_cli.record.identification.modes import Identified, assurance, identify
from pinn_cli.record.signal import Sampling, Signal, guessed, number_of, spectra_of
from pinn_cli.settings.errors import InputError

# A peak of the spectra belongs to a mode within so many half-power widths and lines.
PEAK_WIDTHS, PEAK_LINES = 2.0, 2.0
# Shapes at fewer common sensors say nothing of two modes.
FEWEST_SENSORS = 2
# So many frequencies are listed in a sentence.
MOST_LISTED = 10
# Modes of two records are the same where their frequencies differ by this part, or by so many deviations, at most (a
# bridge's move by one or two per cent with the weather), and their shapes at common sensors are alike.
ALIKE_FREQUENCY, SAME_DEVIATIONS, ALIKE_SHAPE = 0.03, 3.0, 0.5
# Of a shape's largest entry, the least deviation that one counts with.
LEAST_DEVIATION = 1e-4
# Turns of least squares, and the change of a shape that ends them.
TURNS, SHAPE_SETTLED = 200, 1e-6


@dataclass(frozen=True, eq=False)
class ModalRecord:
    """A record and the modes that it shows.

    Attributes:
        sensors: Of the response, S of them.
        acting: What acts, as far as it was measured.
        sampling: Of the record.
        identified: Its modes.
        placed: Whether somebody, or the columns' names, say at which DOF each sensor is; else they were counted.
    """

    sensors: Sequence[Signal]
    acting: Sequence[Signal]
    sampling: Sampling
    identified: Identified
    placed: bool = True

    @classmethod
    def of(cls, signals: Sequence[Signal], time: np.ndarray) -> ModalRecord:
        """Of a record's columns: what nobody has said is guessed by their names, else they count as sensors.

        Raises:
            InputError: There are too few samples, or no sensor varies.
        """
        sampling = Sampling(time)
        guesses = guessed(signals)[0]
        placed = all(str(number_of(a)) == b.place for a, b in zip(signals, guesses, strict=False) if not b.is_input)
        alive = [signal.in_si()[0] for signal in guesses or signals if signal.varies]
        if not any(not signal.is_input for signal in alive):
            raise InputError("data.path", f"{len(signals)} columns", "a record with a sensor of the motion that varies")
        return replace(cls.of_alive(alive, sampling), placed=placed)

    @classmethod
    def of_alive(cls, signals: Sequence[Signal], sampling: Sampling) -> ModalRecord:
        """Of columns in SI units that vary."""
        sensors, acting = ([s for s in signals if s.is_input == acts] for acts in (False, True))
        outputs, inputs = (
            np.array([sampling.on_regular(s.values) for s in some]).reshape(len(some), len(sampling.regular)).T
            for some in (sensors, acting)
        )
        return cls(sensors, acting, sampling, identify(outputs, inputs, 1.0 / sampling.rate))

    @property
    def modes(self) -> Sequence[RecordMode]:
        """By frequency."""
        return self.identified.modes

    @property
    def remarks(self) -> list[str]:
        """What steady lines there are: of machines, and of what acts."""
        machines = self.identified.machines
        says = [f"steady lines at {_listed(machines)} Hz, as of machines or of mains: no modes"] if machines else []
        for signal, tones in zip(self.acting, self.identified.tones, strict=True):
            if len(tones):
                says.append(
                    f"{signal.name} acts at {len(tones)} frequencies alone ({_listed(tones)} Hz): modes show where"
                    " several of them lie within a resonance; a structure whose DOFs are given is found by all of them"
                )
        return says

    @property
    def names(self) -> list[str]:
        """Of the sensors, as columns have them: DOFs where each has one, else the columns of the file."""
        return self.places or [signal.column for signal in self.sensors]

    @property
    def places(self) -> list[str]:
        """Number or name of every sensor's DOF; none where not each has one of its own."""
        places = [signal.place if signal.quantity else "" for signal in self.sensors]
        return places if self.placed and all(places) and len(set(places)) == len(places) else []

    @cached_property
    def shapes(self) -> np.ndarray:
        """(modes, S), displacements, complex; the largest is one."""
        shapes = [mode.shape * factors for mode, factors in zip(self.modes, self._to_displacements, strict=True)]
        return np.array(shapes).reshape(-1, len(self.sensors))

    @cached_property
    def _to_displacements(self) -> list[np.ndarray]:
        """Of every mode (S,), what turns its shape into displacements that are as near to real as it goes."""
        scales, orders = [], np.array([signal.order for signal in self.sensors])
        for mode in self.modes:
            factors = (2j * np.pi * mode.frequency) ** -(orders - orders[0]).astype(float)
            factors = factors * np.exp(-0.5j * np.angle(np.sum((mode.shape * factors) ** 2)))
            shape = (mode.shape * factors).real
            scales.append(factors / shape[np.argmax(np.abs(shape))])
        return scales

    def shape_std(self, number: int) -> np.ndarray:
        """(S,), of the real part of a shape."""
        return deviations(self.shapes[number], self.noise(number))

    def noise(self, number: int) -> np.ndarray:
        """(S, S), covariance of the errors of a shape's entries, complex."""
        factors = self._to_displacements[number]
        return np.asarray(np.outer(factors.conj(), factors) * self.modes[number].noise)

    @cached_property
    def spectra(self) -> CrossSpectra[Signal]:
        """Averaged, of the band that the channels fill."""
        return spectra_of([*self.sensors, *self.acting], self.sampling)

    @cached_property
    def decomposition(self) -> tuple[np.ndarray, np.ndarray]:
        """(B, S) singular values and (B, S, S) vectors: of the sensors' spectra, or of their responses to what acts.

        Frequency-domain decomposition: Brincker, Zhang and Andersen, Smart Materials and Structures 10 (2001) 441.
        Every sensor is scaled by its rms.
        """
        s = len(self.sensors)
        size = np.maximum(self.spectra.shown.std(axis=0), 1e-300)
        if self.acting:
            vectors, values, _ = np.linalg.svd(self.spectra.response / size[:, None], full_matrices=False)
        else:
            vectors, values, _ = np.linalg.svd(self.spectra.cross[:, :s, :s] / np.outer(size, size), hermitian=True)
        return values, vectors * size[:, None]

    def peak(self, number: int) -> tuple[float, float]:
        """Frequency of the largest singular value near a mode, Hz, and the MAC of both shapes; NaN: no peak."""
        mode, (values, vectors) = self.modes[number], self.decomposition
        f = self.spectra.frequency
        reach = PEAK_WIDTHS * mode.damping * mode.frequency + PEAK_LINES * f[1]
        near = np.flatnonzero(np.abs(f - mode.frequency) <= reach)
        near = near[(near > 0) & (near < len(f) - 1)]
        if not len(near):
            return np.nan, np.nan
        top = int(near[np.argmax(values[near, 0])])
        if values[top, 0] < max(values[top - 1, 0], values[top + 1, 0]):
            return np.nan, np.nan
        return float(f[top]), alike(vectors[top, :, 0], mode.shape)


def _listed(frequencies: Sequence[float] | np.ndarray) -> str:
    shown = [f"{frequency:.4g}" for frequency in frequencies]
    return ", ".join(shown if len(shown) <= MOST_LISTED else [*shown[:4], "...", shown[-1]])


def alike(first: np.ndarray, second: np.ndarray) -> float:
    """MAC of two shapes (S,); NaN where fewer sensors say nothing."""
    return float(assurance(first[None], second[None])[0, 0]) if len(first) >= FEWEST_SENSORS else np.nan


def names_of(records: Sequence[ModalRecord]) -> list[list[str]]:
    """Names of every record's sensors that mean the same in all: DOFs where all have them, else columns."""
    by_place = all(record.places for record in records)
    return [record.places if by_place else [signal.column for signal in record.sensors] for record in records]


def mac_table(records: Sequence[ModalRecord]) -> pd.DataFrame:
    """Modal assurance criterion between all modes of all records, at the sensors that two of them have in common.

    Columns ``record``, ``mode``, ``frequency``, and one for each mode, ``record_1_mode_1``; NaN with fewer than two.
    """
    modes = [(r, i) for r, record in enumerate(records) for i in range(len(record.modes))]
    values, names = np.full((len(modes), len(modes)), np.nan), names_of(records)
    for a, (r, i) in enumerate(modes):
        for b, (q, j) in enumerate(modes):
            common = [name for name in names[r] if name in names[q]]
            first, second = ([names[n].index(name) for name in common] for n in (r, q))
            values[a, b] = alike(records[r].shapes[i][first], records[q].shapes[j][second])
    numbers = {"record": [r + 1 for r, _ in modes], "mode": [i + 1 for _, i in modes]}
    frequencies = {"frequency": [records[r].modes[i].frequency for r, i in modes]}
    columns = {f"record_{r + 1}_mode_{i + 1}": column for (r, i), column in zip(modes, values.T, strict=True)}
    return pd.DataFrame(numbers | frequencies | columns)


@dataclass(frozen=True, eq=False)
class Part:
    """A mode as one record shows it.

    Attributes:
        record: Number of the record, from 0.
        number: Of the mode among those of the record, from 0.
        mode: As the record has it.
        places: (S,), where the record's sensors stand among those of all records.
        shape: (S,), complex.
        noise: (S, S), covariance of the errors of the real parts.
    """

    record: int
    number: int
    mode: RecordMode
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
        shape_std: (P,), of the real part of the mode's shape.
        scales: (parts,), of the records' shapes: one's own is its scale times the joined one.
        scale_std: (parts,), their relative deviations.
        mac: (parts,), of the record's own shape and the joined one, at the record's sensors.
        mode: Of all records, its shape (P,) at all their sensors: the largest is one, NaN where no record shows it.
        agreement: (2,), probability that chance makes frequencies, and damping ratios, of the records differ as much;
            NaN with one record.
    """

    parts: Sequence[Part]
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
            modes = enumerate(zip(records[r].modes, records[r].shapes, strict=True))
            parts = [Part(r, i, m, places[r], shape, 0.5 * records[r].noise(i).real) for i, (m, shape) in modes]
            _sort_in(groups, parts, len(all_names))
        joined = [_joined(sorted(group, key=lambda part: part.record), len(all_names)) for group in groups]
        joined.sort(key=lambda joined_mode: joined_mode.mode.frequency)
        return cls(records, [by_name[name] for name in all_names], all_names, joined, unconnected)

    @property
    def modes(self) -> Sequence[RecordMode]:
        """By frequency."""
        return [joined_mode.mode for joined_mode in self.joined]

    @property
    def shapes(self) -> np.ndarray:
        """(M, P), see :attr:`JoinedMode.mode`."""
        return np.array([mode.shape for mode in self.modes]).reshape(-1, len(self.sensors))

    def shape_std(self, number: int) -> np.ndarray:
        """(P,), of the real part of a shape."""
        return self.joined[number].shape_std

    @property
    def opposed(self) -> Iterator[tuple[int, int, float]]:
        """Numbers, from 0, of modes of different records at one frequency, whose shapes differ; and their MAC."""
        for i, j in combinations(range(len(self.joined)), 2):
            first, second = self.joined[i], self.joined[j]
            distance = abs(np.log(first.mode.frequency / second.mode.frequency))
            common = np.isfinite(first.mode.shape) & np.isfinite(second.mode.shape)
            mac = alike(first.mode.shape[common], second.mode.shape[common])
            twice = {part.record for part in first.parts} & {part.record for part in second.parts}
            if distance < ALIKE_FREQUENCY and mac < ALIKE_SHAPE and not twice:
                yield i, j, mac

    def peak(self, number: int) -> tuple[float, float]:
        """The mean of the records' peaks near a mode, Hz, and the least MAC of their shapes; NaN: no peak."""
        peaks = np.array([self.records[part.record].peak(part.number) for part in self.joined[number].parts])
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


def _sort_in(groups: list[list[Part]], parts: Sequence[Part], places: int) -> None:
    """Put the modes of one more record to those that they are the same as; the others begin groups of their own."""
    far = 1e3
    cost = np.full((len(parts), len(groups)), far)
    for j, group in enumerate(groups):
        theirs, so_far = group[0].mode, _assembled(group, places)[0]
        for i, part in enumerate(parts):
            mode, there = part.mode, np.isfinite(so_far[part.places])
            distance = abs(np.log(mode.frequency / theirs.frequency))
            deviation = float(mode.covariance[0, 0] + theirs.covariance[0, 0]) ** 0.5
            reach = max(ALIKE_FREQUENCY, SAME_DEVIATIONS * deviation)
            mac = alike(part.shape[there], so_far[part.places][there])
            if there.any() and distance < reach and not mac < ALIKE_SHAPE:
                cost[i, j] = distance / reach + 1.0 - np.nan_to_num(mac, nan=1.0)
    pairs = {i: j for i, j in zip(*linear_sum_assignment(cost), strict=True) if cost[i, j] < far}
    for i, part in enumerate(parts):
        if i not in pairs:
            groups.append([])
        groups[pairs.get(i, -1)].append(part)


def _joined(parts: Sequence[Part], places: int) -> JoinedMode:
    shape, scales = _assembled(parts, places)
    shape_std, scale_std = _deviations(parts, shape, scales)
    modes = [part.mode for part in parts]
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
    return JoinedMode(parts, shape_std, scales, scale_std, mac, mode, (float(agreement[0]), float(agreement[1])))


def _assembled(parts: Sequence[Part], places: int) -> tuple[np.ndarray, np.ndarray]:
    """The shape (P,) of all parts, NaN where there is none, and the scale of each: alternating least squares."""
    shape = np.full(places, np.nan, dtype=complex)
    rest = sorted(parts, key=lambda part: -len(part.places))
    while rest:  # a start: one after the other, by what is known
        part = max(rest, key=lambda part: int(np.isfinite(shape[part.places]).sum()))
        rest.remove(part)
        new = ~np.isfinite(shape[part.places])
        shape[part.places[new]] = part.shape[new] / (_scale(part, shape) or 1.0)
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
    places, largest = len(shape), int(np.nanargmax(np.abs(shape.real)))
    free = np.setdiff1d(np.flatnonzero(np.isfinite(shape)), largest)
    columns, rows = len(free) + len(parts), sum(len(part.places) for part in parts)
    slopes, noise, residual, at = np.zeros((rows, places + len(parts))), np.zeros((rows, rows)), np.zeros(rows), 0
    for i, (part, scale) in enumerate(zip(parts, scales, strict=True)):
        block = slice(at, at + len(part.places))
        slopes[range(block.start, block.stop), part.places] = abs(scale)
        slopes[block, places + i] = shape.real[part.places]
        noise[block, block] = part.noise
        turned = part.shape * np.exp(-1j * np.angle(scale))
        residual[block] = turned.real - abs(scale) * shape.real[part.places]
        at += len(part.places)
    slopes = np.take(slopes, [*free, *range(places, places + len(parts))], axis=1)
    root = np.sqrt(np.concatenate([part.weights for part in parts]))
    inverse = np.linalg.pinv(slopes * root[:, None], rcond=1e-12) * root
    rest = (np.eye(rows) - slopes @ inverse) * root[:, None]
    expected = float(np.trace(rest @ noise @ rest.T))
    usual = expected > 1e-9 * rows and rows > columns
    wider = max(float(np.sum((root * residual) ** 2)) / expected, 1.0) if usual else 1.0
    std = np.sqrt(wider * np.maximum(np.diag(inverse @ noise @ inverse.T), 0.0))
    deviations = np.full(places, np.nan)
    deviations[largest], deviations[free] = 0.0, std[: len(free)]
    return deviations, std[len(free) :] / np.maximum(np.abs(scales), 1e-300)
