"""Modes of a structure, linearised about rest: its poles, natural frequencies, damping ratios and shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment

from pinn_cli.system.connection.nonlinearity import Hysteresis
from pinn_cli.system.parameters import MASS, Parameter
from pinn_cli.system.structure import Structure

# Of the highest natural frequency's square: below it is a rigid body's motion, but for rounding.
RIGID = 1e-12
# Of a parameter, the step of its difference quotient: what a law is at rest is linear in nearly every parameter.
STEP = 1e-4


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

    @property
    def shapes(self) -> np.ndarray:
        """(dofs, 2n), displacements of the DOFs in each mode."""
        return self.structure.shapes.matrix @ self.vectors

    @property
    def pushed(self) -> np.ndarray:
        """(2n, dofs), what a unit force on a DOF puts into each mode."""
        return (self.inputs / self.m) @ self.structure.shapes.matrix.T

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
        return frequency(squares)


def modes_of(structure: Structure) -> Modes:
    """Of a structure at rest: hidden forces that follow the elongations are springs, nonlinear dampers do nothing.

    At rest a friction joint sticks, and a Van der Pol damper feeds energy in: neither is what they do in motion.
    """
    stretch = structure.incidence.matrix.toarray()
    m, n = structure.parameters_like(np.empty(0))[MASS], structure.coordinates
    stiffness, damping = structure.at_rest()
    K, C = (stretch.T @ (values[:, None] * stretch) for values in (stiffness.sum(axis=0), damping[0]))
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-K / m[:, None], -C / m[:, None]]])
    poles, vectors = np.linalg.eig(state)
    return Modes(m, K, C, poles, vectors[:n], np.linalg.inv(vectors)[:, n:], structure)


@dataclass(frozen=True, eq=False)
class NaturalModes:
    """n modes of M u'' + C u' + K u = 0, the lowest frequency first; as many as a finite-element model has.

    A mode that oscillates has two poles, -zeta omega +- i omega sqrt(1 - zeta^2). Modes whose poles are real are those
    of the structure without damping that are left over; their damping ratio, 1 or more, is that of C in their shape.

    Attributes:
        structure: Whose modes they are.
        squares: (n,), omega^2, (rad/s)^2; 0 of a rigid body's motion, negative of a negative stiffness.
        damping_ratios: (n,), zeta; NaN where omega is not positive.
        poles: (n,), 1/s, above the real axis; NaN of modes that do not oscillate.
        vectors: (n, modes), complex: displacements of the coordinates, v' v = 1.
    """

    structure: Structure
    squares: np.ndarray
    damping_ratios: np.ndarray
    poles: np.ndarray
    vectors: np.ndarray

    @classmethod
    def of(cls, structure: Structure) -> NaturalModes | None:
        """Of a structure; None where a parameter of it is unknown, or a mass is not positive."""
        matrices = _by_masses(structure)
        if matrices is None:
            return None
        m, K, C = matrices
        n, (squares, still) = len(m), np.linalg.eigh(K)
        rigid = RIGID * np.abs(squares).max()
        squares[np.abs(squares) <= rigid] = 0.0
        poles, vectors = np.linalg.eig(np.block([[np.zeros((n, n)), np.eye(n)], [-K, -C]]))
        moving = (poles.imag > 0) & (np.abs(poles) ** 2 > rigid)
        poles, vectors = poles[moving], vectors[:n, moving]
        vectors = vectors / np.linalg.norm(vectors, axis=0)
        # Undamped modes that no oscillation belongs to.
        of_poles = linear_sum_assignment(-np.abs(still.T @ vectors))[0]
        rest = np.setdiff1d(np.arange(n), of_poles)
        with np.errstate(divide="ignore", invalid="ignore"):
            aperiodic = np.einsum("ir,ij,jr->r", still, C, still)[rest] / (2.0 * np.sqrt(squares[rest]))
        all_squares = np.concatenate((np.abs(poles) ** 2, squares[rest]))
        order = np.argsort(all_squares, kind="stable")[structure.shapes.below : n - structure.shapes.residual]
        ratios = np.concatenate((-poles.real / np.abs(poles), np.where(squares[rest] > 0, aperiodic, np.nan)))
        shapes = np.hstack((vectors, still[:, rest])) / np.sqrt(m)[:, None]
        shapes = shapes / np.linalg.norm(shapes, axis=0)
        poles = np.concatenate((poles, np.full(len(rest), np.nan)))
        return cls(structure, all_squares[order], ratios[order], poles[order], shapes[:, order])

    @cached_property
    def frequencies(self) -> np.ndarray:
        """(n,), natural frequencies, Hz; NaN of a negative stiffness."""
        return frequency(self.squares)

    @cached_property
    def of_dofs(self) -> np.ndarray:
        """(dofs, modes), complex: displacements of the DOFs."""
        return self.structure.shapes.matrix @ self.vectors

    @cached_property
    def shapes(self) -> np.ndarray:
        """(dofs, modes), as near to real as a turn of their phase makes them, the largest displacement being one."""
        turned = self.of_dofs * np.exp(-0.5j * np.angle(np.sum(self.of_dofs**2, axis=0)))
        largest = turned.real[np.abs(turned.real).argmax(axis=0), np.arange(turned.shape[1])]
        return turned.real / np.where(largest == 0, 1.0, largest)

    def assurance(self, other: NaturalModes) -> np.ndarray:
        """(modes, other modes), the modal assurance criterion: 1 where two shapes are the same, 0 where orthogonal."""
        across = np.abs(self.of_dofs.conj().T @ other.of_dofs) ** 2
        sizes = np.outer(*(np.sum(np.abs(x.of_dofs) ** 2, axis=0) for x in (self, other)))
        return np.divide(across, sizes, out=np.zeros_like(across), where=sizes > 0)

    def partners(self, other: NaturalModes) -> np.ndarray:
        """(modes,), the mode of another structure with as many that each is most like, every one taken once."""
        return linear_sum_assignment(-self.assurance(other))[1]

    def slopes(self, parameters: Sequence[Parameter]) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of ``squares`` and of ``damping_ratios`` by single parameters, each (modes, p); 0 by a sensor's.

        Of poles: s' = -v' (s^2 M' + s C' + K') v / v' (2 s M + C) v (Adhikari, AIAA Journal 37, 1999, equation 20). Of
        modes that do not oscillate, with their shapes held.
        """
        m, stretched = self.structure.parameters_like(np.empty(0))[MASS], self.structure.incidence.matrix @ self.vectors
        c = at_rest(self.structure)[1]
        mass, damping = (np.sum(x[:, None] * y**2, axis=0) for x, y in ((m, self.vectors), (c, stretched)))
        periodic = np.isfinite(self.poles)
        # Of modes that do not oscillate: omega^2 and 2 zeta omega by themselves.
        s = np.where(periodic, self.poles, 0.0)
        by_square, by_ratio = (np.zeros((len(s), len(parameters))) for _ in range(2))
        with np.errstate(divide="ignore", invalid="ignore"):
            omega = np.sqrt(np.where(self.squares > 0, self.squares, np.nan))
            for column, (dm, dc, dk) in enumerate(self._changes(parameters, stretched)):
                ds = -(s**2 * dm + s * dc + dk) / (2.0 * s * mass + damping)
                square = np.where(periodic, 2.0 * np.real(np.conj(s) * ds), ((dk - self.squares * dm) / mass).real)
                decay = np.where(periodic, -2.0 * ds.real, ((dc * mass - damping * dm) / mass**2).real)
                by_square[:, column] = square
                by_ratio[:, column] = 0.5 * decay / omega - 0.5 * self.damping_ratios * square / self.squares
        return by_square, by_ratio

    def _changes(
        self, parameters: Sequence[Parameter], stretched: np.ndarray
    ) -> list[tuple[np.ndarray | float, np.ndarray | float, np.ndarray | float]]:
        """Of every parameter, v' M' v, v' C' v and v' K' v of all modes."""
        kinds = [p.kind for p in parameters if p.kind in self.structure.members]
        of_kind = {kind: _by_kind(self.structure, kind) for kind in dict.fromkeys(kinds)}
        changes: list[tuple[np.ndarray | float, np.ndarray | float, np.ndarray | float]] = []
        for p in parameters:
            if p.kind == MASS:
                changes.append((self.vectors[p.index] ** 2, 0.0, 0.0))
            elif p.kind not in of_kind:  # of a sensor
                changes.append((0.0, 0.0, 0.0))
            else:
                connections, which = self.structure.carriers[p.kind]
                dk, dc = of_kind[p.kind][:, which == p.index] @ stretched[connections[which == p.index]] ** 2
                changes.append((0.0, dc, dk))
        return changes


def frequency(square: np.ndarray) -> np.ndarray:
    """Hz, of omega^2; NaN of a negative one."""
    return np.sqrt(np.where(square >= 0, square, np.nan)) / (2.0 * np.pi)


def at_rest(structure: Structure) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness (N/m) and damping (N s/m) of every connection (C,) at rest: its law's and its memory's included."""
    still = torch.zeros(structure.coordinates, dtype=torch.float64)
    linear = structure.linearise(still, still, structure.parameters_like(still))
    k, c = linear.stiffness.numpy().copy(), linear.damping.numpy().copy()
    p = structure.parameters_like(np.empty(0))
    for group, part in zip(structure.groups, structure.parts, strict=True):
        if isinstance(group.nonlinearity, Hysteresis):
            k[part.connections] += group.nonlinearity.stiffness_at_rest(part.of_group(p))
    return k, c


def _by_kind(structure: Structure, kind: str) -> np.ndarray:
    """(2, carriers), stiffness and damping at rest of the connections that have a parameter of a kind, by it."""
    values = structure.parameters[kind].detach().cpu().double()
    step = STEP * torch.clamp(values.abs(), min=1e-3)
    above, below = (np.array(at_rest(structure.with_parameters(**{kind: values + x}))) for x in (step, -step))
    connections, which = structure.carriers[kind]
    return (above - below)[:, connections] / (2.0 * step.numpy()[which])


def undamped_modes(structure: Structure) -> tuple[np.ndarray, np.ndarray] | None:
    """(n,) omega^2, (rad/s)^2, ascending, and (n, n) shapes v of the coordinates with v' M v = 1, one a column.

    None where a parameter is unknown, or a mass is not positive.
    """
    matrices = _by_masses(structure)
    if matrices is None:
        return None
    squares, shapes = np.linalg.eigh(matrices[1])
    return squares, shapes / np.sqrt(matrices[0])[:, None]


def _by_masses(structure: Structure) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """M (n,), and M^-1/2 K M^-1/2 and M^-1/2 C M^-1/2 (n, n) at rest; None: see :func:`undamped_modes`."""
    m = structure.parameters_like(np.empty(0))[MASS]
    k, c = at_rest(structure)
    if not np.isfinite(np.concatenate((m, k, c))).all() or (m <= 0).any():
        return None
    stretch = structure.incidence.matrix.toarray() / np.sqrt(m)
    return m, stretch.T @ (k[:, None] * stretch), stretch.T @ (c[:, None] * stretch)


def frequency_with_oscillator(structure: Structure, place: np.ndarray, mass: float, alone: float) -> float:
    """Natural frequency, Hz, of the mode in which an oscillator moves most that is attached to a DOF.

    How far the DOF moves with every coordinate is ``place`` (n,), and ``alone`` the frequency while it is held, Hz:
    that is told where the oscillator's mass, kg, is not positive.
    """
    m = structure.parameters_like(np.empty(0))[MASS]
    stiffness, n = at_rest(structure)[0], len(m)
    if mass <= 0.0 or (m <= 0.0).any() or not np.isfinite(stiffness).all():
        return alone
    spring, roots = mass * (2.0 * np.pi * alone) ** 2, np.sqrt(np.append(m, mass))
    incidence, stretch = structure.incidence.matrix.toarray(), np.append(place, -1.0)
    k = spring * np.outer(stretch, stretch)
    k[:n, :n] += incidence.T @ (stiffness[:, None] * incidence)
    squares, shapes = np.linalg.eigh(k / np.outer(roots, roots))
    return float(np.sqrt(max(squares[np.argmax(np.abs(shapes[n]))], 0.0))) / (2.0 * np.pi)
