"""The linear chain in modal coordinates: its natural frequencies, its free decays, its response to a record's force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq

from pinn_cli.record.record import Response

if TYPE_CHECKING:
    from pinn_cli.record.channels import Channel
    from pinn_cli.record.record import Record
    from pinn_cli.system.structure import Structure


# Of the highest natural frequency's square: below it is a rigid body's motion, but for rounding.
RIGID = 1e-12


@dataclass(frozen=True, eq=False)
class Modes:
    """Complex modes of M u'' + C u' + K u = f.

    Attributes:
        m: (n,), kg.
        K, C: (n, n), N/m and N s/m.
        poles: (2n,), 1/s.
        vectors: (n, 2n), displacements of the coordinates in each mode.
        inputs: (2n, n), what a unit acceleration f/m on a coordinate puts into each mode.
        structure: Whose modes they are.
    """

    m: np.ndarray
    K: np.ndarray
    C: np.ndarray
    poles: np.ndarray
    vectors: np.ndarray
    inputs: np.ndarray
    structure: Structure

    @classmethod
    def of(cls, structure: Structure) -> Modes:
        """Of the linear part of a structure."""
        p, stretch = structure.parameters_like(np.empty(0)), structure.incidence.matrix.toarray()
        m, n = p["m"], structure.coordinates
        K, C = (stretch.T @ (p[kind][:, None] * stretch) for kind in ("k", "c"))
        state = np.block([[np.zeros((n, n)), np.eye(n)], [-K / m[:, None], -C / m[:, None]]])
        poles, vectors = np.linalg.eig(state)
        return cls(m, K, C, poles, vectors[:n], np.linalg.inv(vectors)[:, n:], structure)

    @property
    def shapes(self) -> np.ndarray:
        """(dofs, 2n), displacements of the DOFs in each mode."""
        of = self.structure.shapes
        return self.vectors if of is None else of.matrix @ self.vectors

    @property
    def pushed(self) -> np.ndarray:
        """(2n, dofs), what a unit force on a DOF puts into each mode."""
        of = self.structure.shapes
        every = self.inputs / self.m
        return every if of is None else every @ of.matrix.T

    @property
    def stable(self) -> bool:
        """Whether every free motion dies away; rounding is not held against it."""
        return bool(np.all(self.poles.real <= 1e-9 * np.abs(self.poles)))

    @property
    def natural_frequencies(self) -> np.ndarray:
        """(n,) undamped, Hz, ascending; 0 of a rigid body's motion, NaN where the stiffness is negative."""
        root = np.sqrt(self.m)
        squares = np.linalg.eigvalsh(self.K / np.outer(root, root))
        squares[np.abs(squares) <= RIGID * np.abs(squares).max()] = 0.0
        return np.sqrt(np.where(squares >= 0, squares, np.nan)) / (2 * np.pi)

    def response(self, record: Record) -> Response:
        """The response to the record's force, at its samples, up to free decays: its force repeats itself for ever.

        So does the motion of its ground; accelerations are in the record's frame. The force is that of the record's
        ``intersample``: its sinusoids as they are, or held from sample to sample, which delays them by half a step and
        weakens them by a sinc.

        Raises:
            ValueError: A force is unknown.
        """
        if not np.isfinite(record.force).all():
            raise ValueError("a response needs every force")
        of = self.structure.shapes
        force = rfft(record.force if of is None else of.onto_coordinates(record.force), axis=0)
        s = 2j * np.pi * rfftfreq(len(record.time), record.step)
        acting = force
        if record.intersample == "zero_order_hold":
            angle = 0.5 * s.imag * record.step
            acting = force * (np.exp(-1j * angle) * np.sinc(angle / np.pi))[:, None]
        shaking = np.zeros((1, len(self.m)))
        if record.ground_acceleration is not None:
            shaking = rfft(record.ground_acceleration)[:, None] * self.structure.with_ground
        with np.errstate(divide="ignore", invalid="ignore"):  # without stiffness there is no answer to a mean force
            u = ((acting / self.m - shaking) @ self.inputs.T / (s[:, None] - self.poles)) @ self.vectors.T
        v = s[:, None] * u
        a = (force - v @ self.C.T - u @ self.K.T) / self.m
        if record.frame == "relative" or of is not None:
            a = a - shaking
        u, v, a = (irfft(x, len(record.time), axis=0) for x in (u, v, a))
        if of is not None:
            u, v, a = (of.of_dofs(x) for x in (u, v, a))
            if record.ground_acceleration is not None and record.frame == "absolute":
                a = a + record.ground_acceleration[:, None] * of.with_ground
        return Response(record.time, u, v, a, record.force, record.ground_acceleration)

    def decays(self, channel: Channel, record: Record) -> np.ndarray:
        """Orthonormal histories (N, p), p <= 2n: all that a free motion can put into a channel.

        Whatever the structure did before the record began, and what the repeated force of :meth:`response` leaves over
        from the end, lies in their span.
        """
        upper = self.poles.imag >= 0
        poles, shape = self.poles[upper], self.shapes[channel.dof, upper]
        moving = np.abs(shape) > 1e-9 * np.max(np.abs(self.shapes))
        time = record.time - record.time[0]
        waves = np.exp(np.minimum(poles[moving].real, 0.0) * time[:, None] + 1j * poles[moving].imag * time[:, None])
        basis, triangle = np.linalg.qr(np.hstack([waves.real, waves.imag]))
        size = np.abs(np.diag(triangle))
        return basis[:, size > 1e-8 * np.max(size, initial=1e-300)]


def modes_of(structure: Structure) -> Modes:
    """Of the linear part of a structure."""
    return Modes.of(structure)
