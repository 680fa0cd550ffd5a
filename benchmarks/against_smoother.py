"""Our error against that of a Kalman smoother whose process noise is tuned by hand: ``make against-smoother``.

The default 6-DOF chain without model error, its force exact between the samples, at several signal-to-noise ratios,
over seeds that draw force and noise anew. Errors are 100 - fitness (printed formula), mean over DOFs and seeds. Tuned
by hand means chosen with the truth, as only a benchmark may: at each ratio and for each quantity by itself, the level
of a grid around the evidence's own that gives the smallest mean error, so that no one smoother can do better.
The smoother's parameters are the prescribed ones, which are the true ones; ours are so too (``fixed``) or uncertain, as
by default.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pinn_cli.baseline.kalman_smoother import KalmanSmoother
from pinn_cli.cli.composing import compose_config
from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.prepare import PreparedProblem, prepare_problem
from pinn_cli.record.response import QUANTITIES
from pinn_cli.report.fitness import fitness_percent
from pinn_cli.training.estimate import RunContext

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pinn_cli.record.response import Response
    from pinn_cli.training.estimate import Estimate

RATIOS_DB = (50, 20, 10)
FACTORS = (0.1, 1.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
ALLOWED = 1.1
FIXED, UNCERTAIN = "scheme.parameter_uncertainty=0", "scheme.parameter_uncertainty=0.075"


def errors(estimate: Estimate, truth: Response) -> dict[str, float]:
    """100 - fitness in percent of each quantity, mean over the DOFs whose truth is not constant."""
    scores = {q: fitness_percent(getattr(estimate.response, q), getattr(truth, q)) for q in QUANTITIES}
    return {quantity: float(np.nanmean(100.0 - score)) for quantity, score in scores.items()}


def measured(snr_db: float, seeds: int) -> Iterator[dict[str, object]]:
    """A row per estimator and seed: ``estimator, snr_db, seed`` and the error of every quantity.

    Raises:
        DivergenceError: The smoother found no estimate.
    """
    fixed, levels = [], []

    def row(name: str, seed: int, estimate: Estimate, prepared: PreparedProblem) -> dict[str, object]:
        return {"estimator": name, "snr_db": snr_db, "seed": seed, **errors(estimate, prepared.truth.response)}

    for seed in range(seeds):
        drawn = [f"noise.snr_db={snr_db}", f"seed={seed}", f"excitation.seed={seed}", "simulation.hold=exact"]
        for name, setting in (("uncertain", UNCERTAIN), ("fixed", FIXED)):
            config = RunConfig.read(compose_config([*drawn, setting]))
            prepared, run = prepare_problem(config), RunContext("cpu", seed)
            yield row(name, seed, config.estimator.solve(prepared.problem, run), prepared)
        fixed.append(prepared)
        found = KalmanSmoother().solve(prepared.problem, run)
        levels.append(found.noise.discrepancy)
        yield row("evidence", seed, found, prepared)
    centre = float(np.exp(np.mean(np.log(levels))))
    for level in centre * np.array(FACTORS):
        for seed, prepared in enumerate(fixed):
            found = KalmanSmoother(process_noise=float(level)).solve(prepared.problem, RunContext("cpu", seed))
            yield row(f"process noise {level:.3g} N", seed, found, prepared)


def compared(rows: pd.DataFrame) -> pd.DataFrame:
    """Mean errors and their ratio to the hand-tuned smoother's: one row per SNR, estimator and quantity."""
    means = rows.groupby(["snr_db", "estimator"], sort=False)[list(QUANTITIES)].mean()
    parts = []
    for snr_db, of in means.groupby(level="snr_db", sort=False):
        named = of.droplevel("snr_db")
        tuned = named[named.index.str.startswith("process noise")]
        for estimator in ("uncertain", "fixed", "evidence"):
            part = pd.DataFrame({"error_percent": named.loc[estimator], "hand_tuned_error_percent": tuned.min()})
            part["hand_tuned_level"] = tuned.idxmin().str.removeprefix("process noise ")
            parts.append(part.rename_axis("quantity").reset_index().assign(snr_db=snr_db, estimator=estimator))
    table = pd.concat(parts, ignore_index=True)
    table["ratio"] = table["error_percent"] / table["hand_tuned_error_percent"]
    return table[["snr_db", "estimator", "quantity", "error_percent", "hand_tuned_error_percent", "ratio",
                  "hand_tuned_level"]]  # fmt: skip


def main() -> int:
    """Measure, print, write ``outputs/bench/against_smoother*.csv``; 1 if an error of ours is above `ALLOWED`."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.against_smoother", description=__doc__.partition("\n")[0]
    )
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--snr-db", type=float, nargs="*", default=RATIOS_DB)
    given = parser.parse_args()
    folder = Path("outputs/bench")
    folder.mkdir(parents=True, exist_ok=True)
    rows = pd.DataFrame()
    for snr_db in given.snr_db:
        rows = pd.concat([rows, pd.DataFrame(measured(snr_db, given.seeds))], ignore_index=True)
        table = compared(rows)
        print(table[table["snr_db"] == snr_db].round(3).to_string(index=False), flush=True)
    rows.to_csv(folder / "against_smoother_by_seed.csv", index=False)
    table.to_csv(folder / "against_smoother.csv", index=False)
    print(folder / "against_smoother.csv")
    ours = table[table["estimator"] != "evidence"]
    return int(bool((ours["ratio"] > ALLOWED).any()))


if __name__ == "__main__":
    raise SystemExit(main())
