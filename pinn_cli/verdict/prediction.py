"""What a structure does under the measured force and the ground's motion alone: no response sensor is looked at."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.free_run import NoFreeRunError, affordable, free_run, is_linear
from pinn_cli.system.modes import Modes, modes_of
from pinn_cli.system.support import loose_dofs

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pinn_cli.record.channels import Channel
    from pinn_cli.record.record import Record
    from pinn_cli.record.response import Response
    from pinn_cli.system.structure import Structure

# Samples for each pole that a part of a record needs: of fewer free decays leave nothing to compare.
SAMPLES_PER_POLE = 8


@dataclass(frozen=True, eq=False)
class Prediction:
    """A response to the measured force, and the part of the record that it is of.

    Attributes:
        response: (M, n) each; how the structure began does not matter.
        record: Its first M samples.
        modes: Of the structure without its nonlinearity, whose free decays count as part of the prediction.
    """

    response: Response
    record: Record
    modes: Modes
    _decays: dict[tuple[int, ...], np.ndarray] = field(default_factory=dict)

    def decays(self, channel: Channel) -> np.ndarray:
        """See :func:`decays`; channels that feel the same modes share theirs."""
        seen = felt_modes(self.modes, channel)
        if seen not in self._decays:
            self._decays[seen] = decays(self.modes, seen, self.record)
        return self._decays[seen]


def predicted(structure: Structure, record: Record, start: Sequence[np.ndarray] | None = None) -> Prediction | None:
    """The free run of a structure through as much of a record as is affordable; None where it has none.

    That of a linear structure whose free motion grows is none either.

    Args:
        structure: Any.
        record: For what acts.
        start: See :func:`pinn_cli.record.free_run.free_run`. Of a linear structure it does not matter.
    """
    try:
        part = affordable(structure, record)
        response = free_run(structure, part, start)
    except NoFreeRunError:
        return None
    found = prediction_of(structure, part, response)
    short = found is not None and part is not record and len(part.time) < SAMPLES_PER_POLE * len(found.modes.poles)
    return None if short else found


def prediction_of(structure: Structure, record: Record, response: Response) -> Prediction | None:
    """The same, where somebody has the free run already."""
    modes = modes_of(structure)
    # A body that nothing holds moves away, and is no less stable for it.
    grows = is_linear(structure) and not modes.stable and not loose_dofs(structure)
    return None if grows else Prediction(response, record, modes)


def felt_modes(modes: Modes, channel: Channel) -> tuple[int, ...]:
    """Numbers of the modes, one of every pair, that move where a channel's sensor is."""
    upper = np.flatnonzero(modes.poles.imag >= 0)
    shape = modes.shapes[channel.dof, upper]
    return tuple(upper[np.abs(shape) > 1e-9 * np.max(np.abs(modes.shapes))].tolist())


def decays(modes: Modes, felt: Sequence[int], record: Record) -> np.ndarray:
    """Orthonormal histories (N, p), p <= 2n: all that a free motion can put into a channel that feels some modes.

    Whatever the structure did before the record began lies in their span.
    """
    poles = modes.poles[list(felt)]
    time = record.time - record.time[0]
    waves = np.exp(np.minimum(poles.real, 0.0) * time[:, None] + 1j * poles.imag * time[:, None])
    basis, triangle = np.linalg.qr(np.hstack([waves.real, waves.imag]))
    size = np.abs(np.diag(triangle))
    return basis[:, size > 1e-8 * np.max(size, initial=1e-300)]
