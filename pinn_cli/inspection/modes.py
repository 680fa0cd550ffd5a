"""Modes of records, beside frequency-domain decomposition and each other (``pinn-run modes``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd

from pinn_cli.record.cross_spectra import CrossSpectra
from pinn_cli.record.identification.lines import RecordMode, deviations
from pinn_cli.record.identification.modes import Identified, identify
from pinn_cli.record.identification.subspace import assurance
from pinn_cli.record.signal import Sampling, Signal, guessed, number_of, spectra_of
from pinn_cli.settings.errors import InputError

# A peak of the spectra belongs to a mode within so many half-power widths and lines.
PEAK_WIDTHS, PEAK_LINES = 2.0, 2.0
# Shapes at fewer common sensors say nothing of two modes.
FEWEST_SENSORS = 2
# So many frequencies are listed in a sentence.
MOST_LISTED = 10


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
        sampling = Sampling.of(time)
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
        scales = []
        for mode in self.modes:
            factors = (2j * np.pi * mode.frequency) ** -self._orders.astype(float)
            factors = factors * np.exp(-0.5j * np.angle(np.sum((mode.shape * factors) ** 2)))
            shape = (mode.shape * factors).real
            scales.append(factors / shape[np.argmax(np.abs(shape))])
        return scales

    @property
    def _orders(self) -> np.ndarray:
        orders = np.array([signal.order for signal in self.sensors])
        return orders - orders[0]

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
        near = np.flatnonzero(
            np.abs(f - mode.frequency) <= PEAK_WIDTHS * mode.damping * mode.frequency + PEAK_LINES * f[1]
        )
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
            at = ([names[n].index(name) for name in common] for n in (r, q))
            values[a, b] = alike(
                *(records[n].shapes[m][sensors] for n, m, sensors in zip((r, q), (i, j), at, strict=True))
            )
    table = pd.DataFrame(values, columns=[f"record_{r + 1}_mode_{i + 1}" for r, i in modes])
    table.insert(0, "record", [r + 1 for r, _ in modes])
    table.insert(1, "mode", [i + 1 for _, i in modes])
    table.insert(2, "frequency", [records[r].modes[i].frequency for r, i in modes])
    return table
