"""Modes of records, beside frequency-domain decomposition, each other and those of a structure (``pinn-run modes``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
import pandas as pd

from pinn_cli.inspection.guesses import guessed, number_of
from pinn_cli.record.cross_spectra import CrossSpectra
from pinn_cli.record.identification.lines import deviations
from pinn_cli.record.identification.modes import NORMAL_90, Identified, RecordMode, identify
from pinn_cli.record.identification.subspace import assurance
from pinn_cli.record.record import MINIMUM_SAMPLES
from pinn_cli.record.signal import Sampling, Signal, spectra_of
from pinn_cli.settings.errors import InputError
from pinn_cli.system.quantities import MOTION

if TYPE_CHECKING:
    from pinn_cli.system.modes import NaturalModes

MODE_COLUMNS = (
    "mode", "frequency", "lower_90", "upper_90", "damping_ratio", "damping_ratio_lower_90", "damping_ratio_upper_90",
    "mac", "prescribed_frequency", "prescribed_damping_ratio", "explained", "fdd_frequency", "fdd_mac",
)  # fmt: skip
# A peak of the spectra belongs to a mode within so many half-power widths and lines.
PEAK_WIDTHS, PEAK_LINES = 2.0, 2.0
# Shapes at fewer common sensors say nothing of two modes.
FEWEST_SENSORS = 2


class ModesAtSensors(Protocol):
    """Modes and their shapes, of a record or of several together; M modes, S sensors."""

    @property
    def sensors(self) -> Sequence[Signal]:
        """Of the response, S of them."""

    @property
    def names(self) -> Sequence[str]:
        """Of the sensors, as columns have them."""

    @property
    def modes(self) -> Sequence[RecordMode]:
        """By frequency."""

    @property
    def shapes(self) -> np.ndarray:
        """(M, S), displacements, complex; the largest is one. NaN where a mode was not measured."""

    def shape_std(self, number: int) -> np.ndarray:
        """(S,), of the real part of a shape."""

    def peak(self, number: int) -> tuple[float, float]:
        """Frequency of the largest singular value near a mode, Hz, and the MAC of both shapes; NaN: no peak."""


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
        if len(time) < MINIMUM_SAMPLES:
            allowed = f"a record of at least {MINIMUM_SAMPLES} samples"
            raise InputError("data.start, data.stop", f"{len(time)} samples", allowed)
        guesses = guessed(signals)[0]
        placed = all(str(number_of(a)) == b.place for a, b in zip(signals, guesses, strict=False) if not b.is_input)
        alive = [signal.in_si()[0] for signal in guesses or signals if signal.varies]
        if not any(not signal.is_input for signal in alive):
            raise InputError("data.path", f"{len(signals)} columns", "a record with a sensor of the motion that varies")
        return replace(cls.of_alive(alive, Sampling(time)), placed=placed)

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
        found = []
        for mode in self.modes:
            factors = (2j * np.pi * mode.frequency) ** -self._orders.astype(float)
            factors = factors * np.exp(-0.5j * np.angle(np.sum((mode.shape * factors) ** 2)))
            shape = (mode.shape * factors).real
            found.append(factors / shape[np.argmax(np.abs(shape))])
        return found

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
        alike = assurance(vectors[top, :, 0][None], mode.shape[None])[0, 0]
        return float(f[top]), float(alike) if len(self.sensors) >= FEWEST_SENSORS else np.nan


def mode_table(record: ModesAtSensors, structure: NaturalModes | None) -> pd.DataFrame:
    """A row for each mode, columns `MODE_COLUMNS`, then its displacement at every sensor with its 90 % interval.

    Args:
        record: With its modes.
        structure: Whose modes stand beside; None: no parameters were given.
    """
    beside = _partners(record, structure)
    rows = []
    for i, mode in enumerate(record.modes):
        row = dict.fromkeys(MODE_COLUMNS, np.nan) | {
            "mode": i + 1, "frequency": mode.frequency, "damping_ratio": mode.damping, "explained": mode.explained,
        }  # fmt: skip
        row["lower_90"], row["upper_90"] = mode.frequency_interval
        row["damping_ratio_lower_90"], row["damping_ratio_upper_90"] = mode.damping_interval
        row["fdd_frequency"], row["fdd_mac"] = record.peak(i)
        if structure is not None and i in beside:
            other, row["mac"] = beside[i]
            row["prescribed_frequency"] = float(structure.frequencies[other])
            row["prescribed_damping_ratio"] = float(structure.damping_ratios[other])
        for name, value, std in zip(record.names, record.shapes[i].real, record.shape_std(i), strict=True):
            row |= {f"shape_{name}": value, f"shape_{name}_lower_90": value - NORMAL_90 * std,
                    f"shape_{name}_upper_90": value + NORMAL_90 * std}  # fmt: skip
        rows.append(row)
    return pd.DataFrame(rows, columns=None if rows else list(MODE_COLUMNS))


def _partners(record: ModesAtSensors, structure: NaturalModes | None) -> dict[int, tuple[int, float]]:
    """Of a mode's number the number of the structure's mode, and the MAC, NaN where too few sensors have a DOF."""
    from scipy.optimize import linear_sum_assignment

    if structure is None or not record.modes:
        return {}
    usable = np.flatnonzero(np.isfinite(structure.frequencies) & (structure.frequencies > 0.0))
    at = [(i, int(s.place) - 1) for i, s in enumerate(record.sensors) if s.quantity in MOTION and s.place.isdecimal()]
    at = [(i, dof) for i, dof in at if dof < len(structure.of_dofs)]
    f = np.array([mode.frequency for mode in record.modes])
    apart = np.abs(np.log(f[:, None] / structure.frequencies[usable]))
    alike = np.full(apart.shape, np.nan)
    for i, shape in enumerate(record.shapes):
        there = [(sensor, dof) for sensor, dof in at if np.isfinite(shape[sensor])]
        if len(there) >= FEWEST_SENSORS:
            sensors, dofs = map(list, zip(*there, strict=True))
            alike[i] = assurance(shape[None, sensors], structure.of_dofs[dofs][:, usable].T)[0]
    pairs = linear_sum_assignment(apart + 1.0 - np.nan_to_num(alike))
    return {int(i): (int(usable[j]), float(alike[i, j])) for i, j in zip(*pairs, strict=True)}


def names_of(records: Sequence[ModalRecord]) -> list[list[str]]:
    """Names of every record's sensors that mean the same in all: DOFs where all have them, else columns."""
    by_place = all(record.places for record in records)
    return [record.places if by_place else [signal.column for signal in record.sensors] for record in records]


def mac_table(records: Sequence[ModalRecord]) -> pd.DataFrame:
    """Modal assurance criterion between all modes of all records, at the sensors that two of them have in common.

    Columns ``record``, ``mode``, ``frequency``, and one for each mode, ``record_1_mode_1``; NaN with fewer than two.
    """
    every = [(r, i) for r, record in enumerate(records) for i in range(len(record.modes))]
    values, names = np.full((len(every), len(every)), np.nan), names_of(records)
    for a, (r, i) in enumerate(every):
        for b, (q, j) in enumerate(every):
            common = [name for name in names[r] if name in names[q]]
            if len(common) >= FEWEST_SENSORS:
                one, other = (
                    records[n].shapes[m][[names[n].index(name) for name in common]] for n, m in ((r, i), (q, j))
                )
                values[a, b] = assurance(one[None], other[None])[0, 0]
    found = pd.DataFrame(values, columns=[f"record_{r + 1}_mode_{i + 1}" for r, i in every])
    found.insert(0, "record", [r + 1 for r, _ in every])
    found.insert(1, "mode", [i + 1 for _, i in every])
    found.insert(2, "frequency", [records[r].modes[i].frequency for r, i in every])
    return found
