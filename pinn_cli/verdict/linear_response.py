"""What a linear structure does under a record's force, in modal coordinates, and its free decays."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.fft import irfft, rfft, rfftfreq

from pinn_cli.record.response import Response
from pinn_cli.record.supports import told_by

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pinn_cli.record.channels import Channel
    from pinn_cli.record.record import Record
    from pinn_cli.system.modes import Modes


def linear_response(modes: Modes, record: Record) -> Response:
    """The response to the record's force, at its samples, up to free decays: its force repeats itself for ever.

    So does the motion of its ground; accelerations are in the record's frame. The force is that of the record's
    ``intersample``: its sinusoids as they are, or held from sample to sample, which delays them by half a step and
    weakens them by a sinc.

    Raises:
        ValueError: A force is unknown.
    """
    if not np.isfinite(record.force).all():
        raise ValueError("a response needs every force")
    of = modes.structure.shapes
    force = rfft(record.force if of is None else of.onto_coordinates(record.force), axis=0)
    s = 2j * np.pi * rfftfreq(len(record.time), record.step)
    acting = force
    if record.intersample == "zero_order_hold":
        angle = 0.5 * s.imag * record.step
        acting = force * (np.exp(-1j * angle) * np.sinc(angle / np.pi))[:, None]
    shaking = np.zeros((1, len(modes.m)))
    if record.ground_acceleration is not None:
        shaking = rfft(record.ground_acceleration)[:, None] * modes.structure.with_ground
    carried = carried_by(record, modes, s)
    with np.errstate(divide="ignore", invalid="ignore"):  # without stiffness there is no answer to a mean force
        u = (((acting + carried) / modes.m - shaking) @ modes.inputs.T / (s[:, None] - modes.poles)) @ modes.vectors.T
    v = s[:, None] * u
    a = (force + carried - v @ modes.C.T - u @ modes.K.T) / modes.m
    if record.frame == "relative" or of is not None:
        a = a - shaking
    u, v, a = (irfft(x, len(record.time), axis=0) for x in (u, v, a))
    if of is not None:
        u, v, a = (of.of_dofs(x) for x in (u, v, a))
        if record.ground_acceleration is not None and record.frame == "absolute":
            a = a + record.ground_acceleration[:, None] * of.with_ground
    return Response(record.time, u, v, a, record.force, record.ground_acceleration)


def carried_by(record: Record, modes: Modes, s: np.ndarray) -> np.ndarray:
    """(F, n) spectra of the forces of supports that move, those of a linear structure, at s = i omega."""
    structure = modes.structure
    if structure.by_supports is None:
        return np.zeros((1, len(modes.m)))
    (stiffness, damping), n = (x.sum(axis=0) for x in structure.at_rest()), structure.coordinates
    stretch = structure.stretch.matrix.toarray()
    K, C = (-stretch[:, :n].T @ (values[:, None] * stretch[:, n:]) for values in (stiffness, damping))
    out = np.zeros((len(s), n), complex)
    for i, (quantity, order) in enumerate(told_by(record)):
        with np.errstate(divide="ignore", invalid="ignore"):
            moved = rfft(record.supports[quantity][:, i]) / s**order
        moved[0] = 0.0 if order else moved[0]  # no sensor tells where it is
        out += moved[:, None] * (K[:, i] + s[:, None] * C[:, i])
    return out


def felt_modes(modes: Modes, channel: Channel) -> tuple[int, ...]:
    """Numbers of the modes, one of every pair, that move where a channel's sensor is."""
    upper = np.flatnonzero(modes.poles.imag >= 0)
    shape = modes.shapes[channel.dof, upper]
    return tuple(upper[np.abs(shape) > 1e-9 * np.max(np.abs(modes.shapes))].tolist())


def decays(modes: Modes, felt: Sequence[int], record: Record) -> np.ndarray:
    """Orthonormal histories (N, p), p <= 2n: all that a free motion can put into a channel that feels some modes.

    Whatever the structure did before the record began, and what the repeated force of :func:`linear_response` leaves
    over from the end, lies in their span.
    """
    poles = modes.poles[list(felt)]
    time = record.time - record.time[0]
    waves = np.exp(np.minimum(poles.real, 0.0) * time[:, None] + 1j * poles.imag * time[:, None])
    basis, triangle = np.linalg.qr(np.hstack([waves.real, waves.imag]))
    size = np.abs(np.diag(triangle))
    return basis[:, size > 1e-8 * np.max(size, initial=1e-300)]
