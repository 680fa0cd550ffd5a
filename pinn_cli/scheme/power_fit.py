"""How well a structure under forces that nobody measured has the spectra of the sensors: where its resonances are.

Every such force is taken to be as strong as any other, with one power spectrum c omega^p, and so is what begins a free
decay. The level c and the slope p are those that fit best; what is left tells frequencies, shapes and damping.
"""

from __future__ import annotations

import numpy as np

from pinn_cli.record.record import Record
from pinn_cli.scheme.linear_fit import ABOVE_FLOOR, LinearFit, LinearStructure
from pinn_cli.system.frequency_response import Acting


class PowerFit(LinearFit):
    """The unknowns of a :class:`LinearFit`, and the misfit of the logarithms of the sensors' power spectra.

    Args:
        record: Whose forces are not all measured.
        structure: With its unknowns.
    """

    def __init__(self, record: Record, structure: LinearStructure) -> None:
        super().__init__(record, structure)
        every = np.eye(record.ndof)
        self.acting = Acting.forces(every if record.unforced.all() else every[:, ~record.unforced])

    def smooth(self, width: float) -> None:
        """See :meth:`LinearFit.smooth`."""
        s = self.spectra
        self.kernel = s.smoothing(width)
        sensed = self.kernel @ s.power
        self.weight = sensed / (sensed + ABOVE_FLOOR * s.floor)
        self.measured = np.log(np.maximum(sensed, 1e-300))
        at = np.log(self.kernel @ s.omega)
        together = np.stack((np.ones_like(at), at - at.mean()), axis=1)[:, None, :] * self.weight[..., None]
        self.basis, _ = np.linalg.qr(together.reshape(-1, 2))  # of level and slope, the same of all sensors
        self.size = float(np.sum(self._without_spectrum(self.weight * self.measured) ** 2))

    def residual(self, x: np.ndarray) -> np.ndarray:
        """(O, S) misfit of the logarithms."""
        power = np.maximum(self.kernel @ np.sum(np.abs(self._response(x).value) ** 2, axis=2), 1e-300)
        return self._without_spectrum(self.weight * (np.log(power) - self.measured))

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """(O, S, p), of the residual by the structure's unknowns."""
        value = self._response(x).value
        weight = self.weight / np.maximum(self.kernel @ np.sum(np.abs(value) ** 2, axis=2), 1e-300)
        by = [2.0 * np.sum((value.conj() * slope).real, axis=2) for slope in self._response_slopes(x)]
        return np.stack([self._without_spectrum(weight * (self.kernel @ slope)) for slope in by], axis=-1)

    def _without_spectrum(self, logarithms: np.ndarray) -> np.ndarray:
        """Weighed logarithms (O, S) without what the forces' spectrum can make up for."""
        flat = logarithms.reshape(-1)
        left: np.ndarray = flat - self.basis @ (self.basis.T @ flat)
        return left.reshape(logarithms.shape)
