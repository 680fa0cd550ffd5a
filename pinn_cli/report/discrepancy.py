"""The force that a model leaves out, as that of the connection of which it is most doubtful."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.spectrum import periodogram
from pinn_cli.system.natural_modes import NaturalModes
from pinn_cli.training.estimated_structure import estimated_structure

if TYPE_CHECKING:
    from pinn_cli.report.results import Results

# Least of such a force that is drawn, over the force that acts, rms.
NOTICEABLE = 0.01
# Share of the power of the elongation's rate below a frequency; so many times as high a force is drawn that follows it.
MOVING, HARMONICS = 0.95, 4.0
# Classes of equal size, whose means tell whether the force follows something.
CLASSES = 24


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """What one connection would have to pull with, beside its law, for the estimated motion to be the structure's.

    Attributes:
        connection: Its name, or its number from 1.
        time: (L,), s.
        force: (L,), N: the posterior mean.
        slow: (L,), N, the same without what is far above the frequencies of its motion.
        elongation, velocity: (L,), m and m/s.
        natural: Natural frequencies of the estimated structure, Hz.
        missing: Those of modes that are found not to be in the model, Hz.
    """

    connection: str
    time: np.ndarray
    force: np.ndarray
    slow: np.ndarray
    elongation: np.ndarray
    velocity: np.ndarray
    natural: np.ndarray
    missing: tuple[float, ...] = ()

    @classmethod
    def of(cls, results: Results) -> Discrepancy | None:
        """Of a record; None where nothing noticeable is left out, or no connection pulls at its coordinates."""
        estimate, structure = results.estimate, results.prescribed
        misfit, connections = estimate.misfit, estimate.connections
        if misfit is None or connections is None or structure.is_modal or not len(structure.added):
            return None
        pulls = structure.incidence.matrix[structure.added].toarray()
        forces = -misfit.history.astype(np.float64) @ np.linalg.pinv(pulls, rcond=1e-9)
        count = len(forces)
        elongation = connections.elongation[-count:, : len(structure.added)]
        velocity = np.gradient(elongation, misfit.step, axis=0)
        slow = np.column_stack([_slow(f, v, misfit.step) for f, v in zip(forces.T, velocity.T, strict=True)])
        names = [structure.labels.connection(int(i)) for i in structure.added]
        doubted = [
            names.index(d.of.removeprefix("connection ")) for d in estimate.doubts if d.of.startswith("connection ")
        ]
        if not doubted and not np.sqrt(np.mean(slow**2)) > NOTICEABLE * misfit.acting > 0.0:
            return None
        at = doubted[0] if doubted else int(np.argmax(np.mean(slow**2, axis=0)))
        modes = NaturalModes.of(estimated_structure(structure, estimate.parameters))
        missing = tuple(doubt.shape for doubt in estimate.doubts if doubt.kind == "mode")
        return cls(
            names[at],
            results.record.time[-count:],
            forces[:, at],
            slow[:, at],
            elongation[:, at],
            velocity[:, at],
            np.zeros(0) if modes is None else modes.frequencies,
            missing,
        )

    def explained_by(self, history: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Means of a history (L,) and of the force in classes of it, and the share of the force that they explain."""
        parts = np.array_split(np.argsort(history, kind="stable"), CLASSES)
        x, y = (np.array([values[part].mean() for part in parts]) for values in (history, self.slow))
        left = sum(float(np.sum((self.slow[part] - mean) ** 2)) for part, mean in zip(parts, y, strict=True))
        total = float(np.sum((self.slow - self.slow.mean()) ** 2))
        return x, y, max(0.0, 1.0 - left / total) if total > 0.0 else 0.0


def _slow(force: np.ndarray, velocity: np.ndarray, step: float) -> np.ndarray:
    """A force (L,) up to some times the frequency below which nearly all of the velocity is."""
    frequency, power = periodogram(velocity, step)
    share = np.cumsum(power) / max(float(power.sum()), 1e-300)
    edge = HARMONICS * float(frequency[min(int(np.searchsorted(share, MOVING)), len(frequency) - 1)])
    lines = np.fft.rfft(force)
    lines[np.fft.rfftfreq(len(force), step) > edge] = 0.0
    slow: np.ndarray = np.fft.irfft(lines, len(force))
    return slow
