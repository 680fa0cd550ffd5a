"""A sine whose frequency glides through a band."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np

from pinn_cli.record.excitation.excitation import Excitation, checked_band
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import one_of, positive_number

SWEEP_LAWS = ("linear", "logarithmic")


class SineSweep(Excitation):
    """f(t) = sqrt(2) rms sin(2 pi integral_0^t frequency), from the low to the high end of the band over the record.

    Linear: frequency = f_0 + (f_1 - f_0) t / T. Logarithmic: f_0 (f_1 / f_0)^(t / T), equal time per octave.

    Args:
        ndof, duration, samples: Of the chain and the record, see :class:`Excitation`.
        band: [f_0, f_1], Hz.
        rms: Root mean square of the sine, N; its amplitude is sqrt(2) times that.
        dofs: The forced DOFs, counted from 1; all are forced in phase.
        law: ``linear`` or ``logarithmic``.

    Raises:
        InputError: Naming ``excitation.<setting>``.
    """

    def __init__(
        self,
        ndof: int,
        duration: float,
        samples: int,
        band: Sequence[float],
        rms: float,
        dofs: Sequence[int],
        law: Annotated[str, SWEEP_LAWS] = "linear",
    ) -> None:
        super().__init__(ndof, duration, samples, dofs)
        self.band = checked_band(band, self.nyquist)
        self.rms = positive_number("excitation.rms", rms)
        self.law = one_of("excitation.law", law, SWEEP_LAWS)
        if law == "logarithmic" and self.band[0] == 0.0:
            raise InputError("excitation.band", list(self.band), "above 0 Hz", "a logarithmic sweep never leaves 0 Hz")

    def signals(self, time: np.ndarray) -> np.ndarray:
        """See :meth:`Excitation.signals`."""
        return math.sqrt(2.0) * self.rms * np.sin(2.0 * np.pi * self._cycles(time))[:, None]

    def _cycles(self, time: np.ndarray) -> np.ndarray:
        (low, high), duration = self.band, self.duration
        if self.law == "linear":
            return low * time + (high - low) * time**2 / (2.0 * duration)
        growth = math.log(high / low)
        return low * duration / growth * np.expm1(growth * time / duration)
