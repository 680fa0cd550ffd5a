"""The force that a model leaves out, as a record shows it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Numbers of a history that are kept, 4 MB: of a longer record the last part stands for all of it.
MOST_KEPT = 2**20


@dataclass(frozen=True, eq=False)
class Misfit:
    """What the coordinates of a structure feel beside its own law and the inputs that were measured.

    A forgotten spring or a wrong mass leaves out a force that has most of its power at resonances and acts on several
    coordinates at once. A white force of its size moves the structure far less. So the force is kept as it was.

    Attributes:
        step: Between samples, s.
        history: (L, n), N, at even samples: its posterior mean, without the noise of the inputs' sensors.
        acting: N, root mean square of what the measured inputs put into the equations; 0 where nothing was measured.
        rest: N, standard deviation per sample of a white force on every coordinate: what the record leaves open.
        at_motion: Share, root mean square, of it at the frequencies at which the coordinates move: what may hide in the
            parameters; 1 where nobody asked.
    """

    step: float
    history: np.ndarray
    acting: float
    rest: float
    at_motion: float = 1.0

    @classmethod
    def of(cls, step: float, history: np.ndarray, acting: float, rest: float, at_motion: float = 1.0) -> Misfit:
        """Of a history (N, n), of which no more than can be kept is."""
        most = max(2, MOST_KEPT // max(history.shape[1], 1))
        return cls(step, history[-most:].astype(np.float32), acting, rest, at_motion)
