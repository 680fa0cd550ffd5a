"""How well posteriors are calibrated, and how well they are sampled: ``python -m benchmarks.calibration --seeds 40``.

The paper's two 2-DOF chains (240 s, 20 dB, 5 repeats), with the force on the first DOF or on both, over many noise
seeds. Every network is trained as `pinn-run scheme=bayesian` trains it, and its posterior found in several ways:
`marginal` and `conditional` by NUTS, `laplace` and `conditional_laplace` by the Gaussian at the peak of these, in
milliseconds. Printed: mean relative error of the posterior means, share of the 90 % intervals that hold the truth, and
the worst of the sampler's diagnostics.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd
from hydra import compose, initialize_config_module

from pinn_cli.cli.config import RunConfig
from pinn_cli.posterior.base import PosteriorSamples
from pinn_cli.posterior.conditional import Conditional
from pinn_cli.posterior.diagnostics import diagnose
from pinn_cli.posterior.laplace import Laplace
from pinn_cli.posterior.marginal import Marginal
from pinn_cli.record.record import Truth
from pinn_cli.report.parameters import true_value
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.estimate import RunContext
from pinn_cli.training.reported.parameter_likelihoods import ParameterLikelihoods

CASES = ("pe_2dof_duffing", "pe_2dof_van_der_pol")
FORCED = ("[1]", "[1,2]")
METHODS = ("laplace", "conditional_laplace", "marginal", "conditional")


def draws(method: str, found: ParameterLikelihoods, problem: JointProblem, run: RunContext) -> PosteriorSamples:
    """A posterior found in one of the `METHODS`."""
    assert problem.priors
    ways = {"marginal": Marginal, "conditional": Conditional}
    way = ways.get(method, Laplace)()
    first = found.conditional if method == "conditional_laplace" else found.marginal
    return way.sample(first, found.conditional, problem.priors, run)


def posteriors(
    case: str, forced: str, methods: Sequence[str], seeds: int, overrides: list[str]
) -> Iterator[pd.DataFrame]:
    """One table per seed and method: ``parameter, error_percent, holds, r_hat, ess_bulk, divergent, seconds``, ..."""
    settings = [f"experiment=paper/{case}", f"excitation.dofs={forced}", "noise.seeds=null"]
    for seed in range(seeds):
        with initialize_config_module("pinn_cli.conf", version_base="1.3"):
            config = RunConfig.read(compose("config", overrides=[*settings, f"seed={seed}", *overrides]))
        true, prescribed = config.model_error.structures(config.structure)
        measurements = config.source.measure(true)
        problem = config.scheme.pose(prescribed, [config.observe(measurements.record)])
        run = RunContext(seed=seed)
        estimate = config.estimator.solve(problem, run)
        assert estimate.likelihoods is not None
        for method in methods:
            start = time.perf_counter()
            samples = draws(method, estimate.likelihoods, problem, run)
            seconds = time.perf_counter() - start
            yield scored(samples, problem.alone.uncertain, measurements.truth).assign(
                seed=seed, method=method, seconds=seconds
            )


def scored(samples: PosteriorSamples, parameters: Sequence[Parameter], truth: Truth) -> pd.DataFrame:
    """Diagnostics of the parameters with their error and whether the 90 % interval holds the truth."""
    table = diagnose(samples)
    table = table[table["parameter"].isin(samples.names)].copy()
    true = np.array([true_value(parameter, truth.parameters) for parameter in parameters])
    table["error_percent"] = 100.0 * np.abs(table["mean"] / true - 1.0)
    table["holds"] = (table["lower_90"] <= true) & (true <= table["upper_90"])
    table["divergent"] = int(np.sum(samples.statistics.get("diverging", 0)))
    return table


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
    parser.add_argument("--methods", nargs="*", default=METHODS, choices=METHODS)
    parser.add_argument("overrides", nargs="*", help="further settings, as pinn-run takes them (after --)")
    given = parser.parse_args()
    for case in given.cases:
        for forced in given.forced:
            tables = pd.concat(posteriors(case, forced, given.methods, given.seeds, given.overrides))
            for method, part in tables.groupby("method", sort=False):
                print(f"{method}, {case}, force on {forced}: {summary(part)}", flush=True)


if __name__ == "__main__":
    main()
