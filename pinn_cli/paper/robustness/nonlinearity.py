"""Fitness against how nonlinear the chain is, with and without model error: a question that the paper leaves open."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pinn_cli.paper.cases import BESIDE
from pinn_cli.paper.robustness.realisation import Realisation
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.runs.writing import write_table

if TYPE_CHECKING:
    from pathlib import Path

    import pandas as pd

    from pinn_cli.paper.robustness.scored import ScoredRealisations

# N/m^3 and N; 100 N/m^3 and 1 N are the defaults of the chain and of the force.
KAPPAS = (0.0, 10.0, 100.0, 1000.0, 10000.0)
FORCES = (0.3, 1.0, 3.0, 10.0)
MODEL_ERRORS = ("none", "linear", "perturbed")
# Of force and noise together: one draw of the force may happen to dwell at one amplitude.
SEEDS = 2
KEYS = ["model_error", "kappa", "force_rms", "estimator", "quantity"]


def nonlinearity_realisations() -> list[Realisation]:
    """Six DOFs, 50 dB, defaults but for kappa, the force's root mean square and the model error."""
    return [
        Realisation(
            f"{model_error}_kappa{kappa:g}_force{force:g}_seed{seed}",
            (f"system.kappa={kappa}", f"excitation.rms={force}", f"model_error={model_error}", *BESIDE),
            seed, redraws_force=True, columns=(("kappa", kappa), ("force_rms", force)),
        )
        for seed in range(SEEDS)
        for model_error in MODEL_ERRORS
        for kappa in KAPPAS
        for force in FORCES
    ]  # fmt: skip


@dataclass(frozen=True, eq=False)
class NonlinearityScores:
    """Fitness over the grid.

    Attributes:
        scored: The realisations.
        rows: One per realisation, estimator and quantity, over all DOFs (``nonlinearity_by_seed.csv``).
        summary: Mean over the seeds, one row per `KEYS`, with the mean ``strength``, the worst fitness and the number
            of ``seeds`` that there are (``nonlinearity.csv``).
    """

    scored: ScoredRealisations
    rows: pd.DataFrame
    summary: pd.DataFrame

    @property
    def empty(self) -> bool:
        """Whether there is nothing to show."""
        return self.summary.empty

    @classmethod
    def of(cls, scored: ScoredRealisations) -> NonlinearityScores:
        """Tables of the scores that are there."""
        rows = scored.rows("fitness")
        if rows.empty:
            return cls(scored, rows, rows)
        rows = rows[(rows["group"] == "all") & rows["quantity"].isin(RESPONSE_QUANTITIES)].reset_index(drop=True)
        grouped = rows.groupby(KEYS, sort=False)
        summary = grouped[["strength", "fitness_percent", "range_fitness_percent"]].mean()
        summary["worst_fitness_percent"] = grouped["fitness_percent"].min()
        summary.insert(1, "seeds", grouped["seed"].nunique())
        return cls(scored, rows, summary.reset_index())

    def write(self, directory: Path) -> Path:
        """Write both tables; the path of the summary."""
        write_table(self.rows, directory / "nonlinearity_by_seed.csv")
        return write_table(self.summary, directory / "nonlinearity.csv")
