"""The physics residual as the evidence counts it: what the features see of it, and what is out of their reach."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pinn_cli.training.noise_model import NoiseModel


@dataclass(frozen=True, eq=False)
class ForceResiduals:
    """The physics residual of every DOF, split into what the features see of it and what is out of their reach.

    Attributes:
        enforced: (n,) bool, the DOFs whose equation of motion counts.
        seen, unseen: (n,), sums of squares, N^2. Discrepancy and sensor noise make up the one, the noise of a force
            sensor alone the other.
        count, beyond: Independent values of each, for every DOF; ``beyond`` is 0 where nothing is out of reach.
        left_open: (n,), sum of the logarithms by which variances between the samples exceed those at the samples.
        observer: (n,) what the features see of the observer's residual, and its weights; None without one.
    """

    enforced: np.ndarray
    seen: np.ndarray
    unseen: np.ndarray
    count: int
    beyond: int
    left_open: np.ndarray
    observer: tuple[np.ndarray, np.ndarray] | None

    def misfit(self, noise: NoiseModel) -> float:
        """Chi^2 and log variances of what the features see, and of the force sensors' noise beyond."""
        variance, enforced = noise.physics_variance, self.enforced
        total = float((self.seen / variance + self.count * np.log(variance) + self.left_open)[enforced].sum())
        forced = np.isfinite(noise.force) & enforced & (noise.force_variance > 0)
        if self.beyond:
            sensor = noise.force_variance[forced]
            total += float((self.unseen[forced] / sensor + self.beyond * np.log(sensor)).sum())
        if self.observer is not None:
            seen, weight = self.observer
            used = weight > 0
            total += float((seen * weight)[used].sum() - self.count * np.log(weight[used]).sum())
        return total
