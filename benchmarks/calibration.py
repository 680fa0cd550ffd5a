"""How well posteriors are calibrated, and how well they are sampled: ``python -m benchmarks.calibration --seeds 40``.

The paper's two 2-DOF chains (240 s, 20 dB, 5 repeats), with the force on the first DOF or on both, over many noise
seeds. Every posterior is found as `pinn-run scheme=bayesian` finds it. Printed: mean relative error of the posterior
means, share of the 90 % intervals that hold the truth, and the worst of the sampler's diagnostics.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator

import numpy as np
import pandas as pd
from hydra import compose, initialize_config_module

from pinn_cli.config import RunConfig
from pinn_cli.posterior.find import find_posterior
from pinn_cli.report.parameters import true_value
from pinn_cli.training.estimate import RunContext

CASES = ("pe_2dof_duffing", "pe_2dof_van_der_pol")
FORCED = ("[1]", "[1,2]")


def posteriors(case: str, forced: str, method: str, seeds: int, overrides: list[str]) -> Iterator[pd.DataFrame]:
    """One table per seed: ``parameter, error_percent, holds, r_hat, ess_bulk, ess_tail, divergent, seconds``."""
    settings = [f"experiment=paper/{case}", f"excitation.dofs={forced}", "noise.seeds=null", f"posterior={method}"]
    for seed in range(seeds):
        with initialize_config_module("pinn_cli.conf", version_base="1.3"):
            config = RunConfig.read(compose("config", overrides=[*settings, f"seed={seed}", *overrides]))
        true, prescribed = config.model_error.chains(config.chain)
        measurements = config.source.measure(true)
        problem = config.scheme.problem(prescribed, config.observe(measurements.record))
        run = RunContext(seed=seed)
        estimate = config.training.solve(problem, config.network, run)
        start = time.perf_counter()
        found = find_posterior(config.posterior, problem, estimate, run)
        assert found is not None
        table = found.diagnostics[found.diagnostics["parameter"].isin(found.samples.names)].copy()
        truth = np.array([true_value(name, measurements.truth.parameters) for name in table["parameter"]])
        table["error_percent"] = 100.0 * np.abs(table["mean"] / truth - 1.0)
        table["holds"] = (table["lower_90"] <= truth) & (truth <= table["upper_90"])
        table["divergent"] = int(np.sum(found.samples.statistics.get("diverging", 0)))
        table["seconds"] = time.perf_counter() - start
        yield table.assign(seed=seed)


def summary(tables: pd.DataFrame) -> str:
    """Errors by parameter, coverage of all, and the worst diagnostics, in one line."""
    errors = tables.groupby("parameter", sort=False)["error_percent"].mean()
    line = " ".join(f"{name} {value:.2f}" for name, value in errors.items())
    line += f" | cover {100.0 * tables['holds'].mean():.1f} %"
    if tables["r_hat"].notna().any():
        passed = tables.groupby("seed").agg({"r_hat": "max", "ess_bulk": "min", "ess_tail": "min", "divergent": "max"})
        good = (passed["r_hat"] <= 1.01) & (passed[["ess_bulk", "ess_tail"]].min(axis=1) >= 400)
        good &= passed["divergent"] == 0
        line += (
            f" | R-hat {passed['r_hat'].max():.4f}, bulk ESS {passed['ess_bulk'].min():.0f},"
            f" divergences {passed['divergent'].sum()}: {int(good.sum())} of {len(good)} pass"
        )
    return f"{line} | {tables['seconds'].mean():.1f} s"


def main() -> None:
    """Run all cases and print a line for each."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.calibration", description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--cases", nargs="*", default=CASES, choices=CASES)
    parser.add_argument("--forced", nargs="*", default=FORCED, choices=FORCED)
    parser.add_argument("--methods", nargs="*", default=("laplace", "conditional"))
    parser.add_argument("overrides", nargs="*", help="further settings, as pinn-run takes them (after --)")
    given = parser.parse_args()
    for method in given.methods:
        for case in given.cases:
            for forced in given.forced:
                tables = posteriors(case, forced, method, given.seeds, given.overrides)
                print(f"{method}, {case}, force on {forced}: {summary(pd.concat(tables))}", flush=True)


if __name__ == "__main__":
    main()
