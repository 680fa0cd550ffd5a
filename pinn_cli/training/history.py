"""What a training went through: one row per step, and the progress bar."""

from __future__ import annotations

import time

import numpy as np
import pandas as pd
from tqdm import tqdm

from pinn_cli.training.estimate import Watch, unwatched
from pinn_cli.training.noise_model import NoiseModel


class History:
    """One row per accepted step, and the progress bar."""

    def __init__(self, progress: bool, watch: Watch = unwatched) -> None:
        self.rows: list[dict[str, float]] = []
        self.watch = watch
        self.started = time.perf_counter()
        self.bar = tqdm(disable=None if progress else True, unit="step", desc="gauss-newton", leave=False)

    def add(self, losses: dict[str, float], noise: NoiseModel) -> None:
        """Note the loss terms and weights of a step."""
        weights = {f"weight_{q}": 1.0 / np.nanmean(s) ** 2 for q, s in noise.response.items() if not np.isnan(s).all()}
        weights["weight_unforced"] = 1.0 / noise.discrepancy**2
        if not np.isnan(noise.force).all():
            weights["weight_forced"] = 1.0 / (np.nanmean(noise.force) ** 2 + noise.discrepancy**2)
        row = {"iteration": len(self.rows) + 1, "seconds": time.perf_counter() - self.started}
        row.update({f"loss_{name}": value for name, value in losses.items()})
        self.rows.append({**row, **weights})
        self.watch(self.rows[-1])
        self.bar.update()
        self.bar.set_postfix(loss=f"{sum(losses.values()):.3g}", discrepancy=f"{noise.discrepancy:.2g} N")

    def close(self) -> None:
        """Take the bar away."""
        self.bar.close()

    def table(self) -> pd.DataFrame:
        """All steps."""
        return pd.DataFrame(self.rows)
