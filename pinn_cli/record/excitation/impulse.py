"""A blow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pinn_cli.record.excitation.excitation import Excitation
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import finite_number, is_finite_number, positive_number

# A half sine that is sampled less often than this is not recognisable in the record.
SAMPLES_PER_PULSE = 4


class Impulse(Excitation):
    """Half-sine pulse, f(t) = peak sin(pi (t - start) / width) for 0 <= t - start <= width, else 0.

    It is continuous; its slope jumps at both ends, where Runge-Kutta keeps its order only if they are samples.

    Args:
        ndof, duration, samples: Of the chain and the record, see :class:`Excitation`.
        peak: N; may be negative.
        width: Of the pulse, s.
        dofs: The forced DOFs, counted from 1; all are struck at once.
        start: Of the pulse, s.

    Raises:
        InputError: Naming ``excitation.<setting>``; a pulse that leaves the record or is hardly sampled.
    """

    def __init__(
        self,
        ndof: int,
        duration: float,
        samples: int,
        peak: float,
        width: float,
        dofs: Sequence[int],
        start: float = 0.0,
    ) -> None:
        super().__init__(ndof, duration, samples, dofs)
        self.peak = finite_number("excitation.peak", peak)
        self.width = positive_number("excitation.width", width)
        shortest = SAMPLES_PER_PULSE * self.duration / (samples - 1)
        if self.width < shortest:
            hint = f"a pulse takes {SAMPLES_PER_PULSE} samples to be seen"
            raise InputError("excitation.width", width, f">= {shortest:.4g} s", hint)
        latest = self.duration - self.width
        if not is_finite_number(start) or not 0 <= start <= latest:
            raise InputError("excitation.start", start, f"between 0 and {latest:.4g} s", "the pulse leaves the record")
        self.start = float(start)

    def signals(self, time: np.ndarray) -> np.ndarray:
        """See :meth:`Excitation.signals`."""
        phase = (time - self.start) / self.width
        pulse = np.where((phase >= 0) & (phase <= 1), np.sin(np.pi * phase), 0.0)
        return self.peak * pulse[:, None]
