"""How well a structure under forces that nobody measured has the spectra of the sensors: where its resonances are.

Every such force is taken to be as strong as any other, with one power spectrum c omega^p, and so is what begins a free
decay. The level c and the slope p are those that fit best; what is left tells frequencies, shapes and damping.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pinn_cli.record.record import Record
from pinn_cli.scheme.cross_spectra import CrossSpectra
from pinn_cli.scheme.linear_fit import ABOVE_FLOOR, LinearFit

# Of a logarithm, for slopes by differences.
STEP = 1e-5


class PowerFit(LinearFit):
    """The unknowns of a :class:`LinearFit`, and the misfit of the logarithms of the sensors' power spectra.

    Args:
        record: Whose forces are not all measured.
        records: See :meth:`CrossSpectra.of`.
        stretch, known, typical: See :class:`LinearFit`.
    """

    def __init__(
        self, record: Record, records: int, stretch: np.ndarray, known: Mapping[str, np.ndarray], typical: np.ndarray
    ) -> None:
        acting = np.flatnonzero(~record.unforced)
        self.acting = acting if len(acting) else np.arange(record.ndof)
        super().__init__(CrossSpectra.of_sensors_alone(record, records), stretch, known, typical)

    def smooth(self, width: float) -> None:
        """See :meth:`LinearFit.smooth`."""
        s = self.spectra
        self.kernel = s.smoothing(width)
        sensed = self.kernel @ s.of_sensors
        self.weight = sensed / (sensed + ABOVE_FLOOR * s.sensor_floor)
        self.measured = np.log(np.maximum(sensed, 1e-300))
        at = np.log(self.kernel @ s.omega)
        together = np.stack((np.ones_like(at), at - at.mean()), axis=1)[:, None, :] * self.weight[..., None]
        self.basis, _ = np.linalg.qr(together.reshape(-1, 2))  # of level and slope, the same of all sensors
        self.size = float(np.sum(self._without_spectrum(self.weight * self.measured) ** 2))
        self.scatter = 0.0

    def residual(self, x: np.ndarray, slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        """(O, S) misfit of the logarithms and, if wanted, its slopes (O, S, p)."""
        residual = self._misfit(x)
        if not slopes:
            return residual, np.empty(0)
        moved = [self._misfit(x + step) for step in STEP * np.eye(len(x))]
        return residual, np.stack([(one - residual) / STEP for one in moved], axis=-1)

    def _misfit(self, x: np.ndarray) -> np.ndarray:
        _, flexibility, _, _ = self._cross(x, np.zeros(0))
        response = self.spectra.differentiation[:, :, None] * flexibility[:, self.spectra.sensors][:, :, self.acting]
        power = self.kernel @ np.sum(np.abs(response) ** 2, axis=2)
        return self._without_spectrum(self.weight * (np.log(np.maximum(power, 1e-300)) - self.measured))

    def _without_spectrum(self, logarithms: np.ndarray) -> np.ndarray:
        """Weighed logarithms (O, S) without what the forces' spectrum can make up for."""
        flat = logarithms.reshape(-1)
        left: np.ndarray = flat - self.basis @ (self.basis.T @ flat)
        return left.reshape(logarithms.shape)
