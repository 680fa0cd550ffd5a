"""What other estimators are told of a case, and the linear model that they have of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from benchmarks.nearly_right.simulation import by_poles
from benchmarks.trust.structures import Structure


@dataclass(frozen=True)
class Sensor:
    """A channel: its column in the record, quantity, DOF from 0, and the standard deviation of its noise.

    The quantity is displacement, velocity or acceleration relative to the ground, or `absolute` for an absolute
    acceleration.
    """

    channel: str
    quantity: str
    dof: int
    noise: float


@dataclass(frozen=True)
class Input:
    """A measured force, N, or ground acceleration, m/s^2.

    Attributes:
        channel: Its column in the record.
        noise: Standard deviation.
        place: How it acts, (n,): a one at the DOF of a force, minus the masses for the ground.
    """

    channel: str
    noise: float
    place: np.ndarray


@dataclass(frozen=True)
class Told:
    """A linear structure under measured inputs or unmeasured ones, and what is unknown of it.

    Attributes:
        mass: kg, (n,).
        rows: The elongation of each connection is its row times the displacements, (connections, n).
        values: By name (`k_1`, `c_roof`): connection and value, the true one or, for what is unknown, what is believed.
        unknown: Names that are estimated.
        inputs: Forces, or the ground; none where nobody measured them.
        sensors: Channels of the response.
        record: File name.
        uncertainty: Relative standard deviation of what is believed of the unknown ones.
    """

    mass: np.ndarray
    rows: np.ndarray
    values: dict[str, tuple[int, float]]
    unknown: tuple[str, ...]
    inputs: tuple[Input, ...]
    sensors: tuple[Sensor, ...]
    record: str = "record.csv"
    uncertainty: float = np.inf

    @classmethod
    def of(
        cls,
        structure: Structure,
        believed: dict[str, float],
        inputs: tuple[Input, ...],
        sensors: tuple[Sensor, ...],
        uncertainty: float = np.inf,
    ) -> Told:
        """Of a linear structure whose parameters are known but for those that are `believed`, by name."""
        known = structure.parameters()
        values = {
            f"{kind}_{link.name}": (i, believed.get(f"{kind}_{link.name}", known[f"{kind}_{link.name}"]))
            for i, link in enumerate(structure.connections)
            for kind in "ck"
            if kind in link.values
        }
        rows = np.stack([link.row for link in structure.connections])
        return cls(structure.mass, rows, values, tuple(believed), inputs, sensors, uncertainty=uncertainty)

    @property
    def ndof(self) -> int:
        """DOFs."""
        return len(self.mass)

    @property
    def guess(self) -> np.ndarray:
        """Of the unknown parameters, (p,)."""
        return np.array([self.values[name][1] for name in self.unknown])

    @property
    def noise(self) -> np.ndarray:
        """Standard deviations of the sensors."""
        return np.array([sensor.noise for sensor in self.sensors])

    def matrix(self, p: np.ndarray) -> np.ndarray:
        """A of x' = A x + push s with the states x = (u, u'), (2 n, 2 n)."""
        n, values = self.ndof, {name: value for name, (_, value) in self.values.items()}
        values |= dict(zip(self.unknown, p.tolist(), strict=True))
        both = {"k": np.zeros((n, n)), "c": np.zeros((n, n))}
        for name, value in values.items():
            row = self.rows[self.values[name][0]]
            both[name[0]] += value * np.outer(row, row)
        lower = [-both[kind] / self.mass[:, None] for kind in "kc"]
        return np.block([[np.zeros((n, n)), np.eye(n)], lower])

    @property
    def push(self) -> np.ndarray:
        """Of the inputs, (2 n, inputs)."""
        places = np.stack([each.place / self.mass for each in self.inputs], axis=1)
        return np.vstack([np.zeros_like(places), places])

    def observed(self, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """C, (sensors, 2 n), and D, (sensors, inputs), of y = C x + D s."""
        n = self.ndof
        first = {"displacement": 0, "velocity": n}
        every, through = np.vstack([np.eye(2 * n), matrix[n:]]), np.vstack([np.zeros_like(self.push), self.push[n:]])
        at = [sensor.dof + first.get(sensor.quantity, 2 * n) for sensor in self.sensors]
        absolute = np.array([[sensor.quantity == "absolute"] for sensor in self.sensors], float)
        return every[at], through[at] + absolute

    def states(self, p: np.ndarray, start: np.ndarray, force: np.ndarray, dt: float) -> np.ndarray:
        """(batch, samples, 2 n) of parameters (batch, p) and first states (batch, 2 n)."""
        return np.stack([by_poles(self.matrix(a), self.push, b, force, dt) for a, b in zip(p, start, strict=True)])

    def outputs(self, p: np.ndarray, states: np.ndarray, force: np.ndarray) -> np.ndarray:
        """What the sensors show, (batch, samples, sensors)."""
        shown = []
        for each, state in zip(p, states, strict=True):
            C, D = self.observed(self.matrix(each))
            shown.append(state @ C.T + force @ D.T)
        return np.stack(shown)


@dataclass(frozen=True)
class Samples:
    """Of a record: inputs (samples, inputs), sensors (samples, sensors), and the interval, s."""

    inputs: np.ndarray
    sensors: np.ndarray
    dt: float

    @classmethod
    def of(cls, told: Told, table: pd.DataFrame) -> Samples:
        """As the record's columns have them."""
        inputs, sensors = (table[[each.channel for each in of]].to_numpy() for of in (told.inputs, told.sensors))
        return cls(inputs, sensors, float(np.diff(table["t"]).mean()))
