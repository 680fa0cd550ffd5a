"""A motion and the forces that go with it: time histories of every quantity on every DOF.

Arrays are numpy float64 (time, dof), SI units.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from pinn_cli.system.quantities import GROUND, MOTION, SUPPORT

RESPONSE_QUANTITIES = MOTION
QUANTITIES = (*RESPONSE_QUANTITIES, "force")
# All that a sensor may measure.
MEASURED_QUANTITIES = (*QUANTITIES, GROUND, *SUPPORT)


@dataclass(frozen=True, eq=False)
class Response:
    """Motion and force of every DOF; NaN where unknown.

    Attributes:
        time: (N,), s.
        displacement, velocity: (N, n), relative to the ground, m, m/s.
        acceleration: (N, n), m/s^2, in the record's frame: with the ground's (absolute) or without it (relative).
        force: (N, n), external, N; what the ground's motion does to the masses is no external force.
        ground_acceleration: (N,), m/s^2; None where the ground is at rest.
        hidden: (N, h), N, the forces of connections with memory; None where there are none.
        coordinates: (N, 2, c), displacement and velocity of a structure's coordinates, where these are modes and not
            the DOFs; None where they are the DOFs.
        supports: (N, 3, S), displacement, velocity and acceleration of supports that move; None where none does.
        connection_force: (N, C), N, of every connection of the structure; None where nobody worked it out.
    """

    time: np.ndarray
    displacement: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    force: np.ndarray
    ground_acceleration: np.ndarray | None = None
    hidden: np.ndarray | None = None
    coordinates: np.ndarray | None = None
    supports: np.ndarray | None = None
    connection_force: np.ndarray | None = None

    @property
    def measurable(self) -> dict[str, Any]:
        """What sensors may measure of DOFs and ground, by the name that a record has for it; the times as well."""
        return {name: getattr(self, name) for name in ("time", *QUANTITIES, GROUND)}

    def state(self, sample: int) -> list[np.ndarray]:
        """Displacement and velocity of the coordinates at a sample, and hidden forces (h,) where there are any."""
        hidden = () if self.hidden is None else (self.hidden,)
        return [history[sample] for history in (*self._of_coordinates, *hidden)]

    @property
    def _of_coordinates(self) -> tuple[np.ndarray, np.ndarray]:
        if self.coordinates is None:
            return self.displacement, self.velocity
        return self.coordinates[:, 0], self.coordinates[:, 1]

    @property
    def stretching(self) -> tuple[np.ndarray, np.ndarray]:
        """Displacement and velocity of coordinates and, behind them, of supports: what stretches connections."""
        motion = self._of_coordinates
        if self.supports is None:
            return motion
        return np.hstack((motion[0], self.supports[:, 0])), np.hstack((motion[1], self.supports[:, 1]))

    def part(self, first: int, stop: int) -> Response:
        """The samples first to stop (excluded)."""
        histories: dict[str, Any] = {field.name: getattr(self, field.name) for field in fields(self)}
        return replace(self, **{name: x[first:stop] for name, x in histories.items() if x is not None})

    @classmethod
    def unknown(cls, time: np.ndarray, ndof: int) -> Response:
        """A response of which nothing is known."""
        return cls(time, *(np.full((len(time), ndof), np.nan) for _ in QUANTITIES))


@dataclass(frozen=True, eq=False)
class Repeats:
    """What the mean of several repeats does not say; mean and sum of squares together are sufficient for white noise.

    Attributes:
        count: How often the experiment was measured, R.
        samples: N of each.
        square: Quantity to (n,), the ground's acceleration to (1,), sum over samples and repeats of the squared
            distance from the repeats' mean; NaN where there is no sensor.
    """

    count: int
    samples: int
    square: dict[str, np.ndarray]

    @property
    def freedom(self) -> int:
        """Degrees of freedom of a channel's sum of squares, N (R - 1)."""
        return self.samples * (self.count - 1)

    def noise_of_mean(self, quantity: str) -> np.ndarray:
        """(n,) standard deviation of the white noise that is left on the mean of the repeats, from their scatter."""
        return np.sqrt(self.square[quantity] / self.freedom / self.count)
