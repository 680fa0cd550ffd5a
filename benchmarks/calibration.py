"""How well posteriors are calibrated, and how well they are sampled: ``make calibration``.

The paper's two 2-DOF chains (240 s, 20 dB, 5 repeats), with the force on the first DOF or on both, over many noise
seeds. Every network is trained as `pinn-run scheme=bayesian` trains it, and its posterior found in several ways: with
the motion integrated out (marginal) and held (conditional), by the Gaussian at the peak, in milliseconds, of every seed
and by NUTS of the first ones. Two tables: mean relative errors of the posterior means with the share of the 90 %
intervals that hold the truth, and the worst of the sampler's diagnostics.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from operator import call

import numpy as np
import pandas as pd

from benchmarks.written import ROOT, markdown, write
from pinn_cli.cli.composing import compose_config
from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.prepare import prepare_problem
from pinn_cli.posterior.conditional import Conditional
from pinn_cli.posterior.laplace import Laplace
from pinn_cli.posterior.marginal import Marginal
from pinn_cli.posterior.posterior import PosteriorSamples, diagnose
from pinn_cli.record.record import Truth
from pinn_cli.report.parameters import true_value
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.estimate import RunContext
from pinn_cli.training.reported.parameter_likelihoods import ParameterLikelihoods

CASES = {"duffing": "Duffing", "van_der_pol": "Van der Pol"}
FORCED = {"[1]": "force on DOF 1", "[1,2]": "force on both"}
GAUSSIAN, SAMPLED = ("laplace", "conditional_laplace"), ("marginal", "conditional")
PAGE = ROOT / "docs" / "method.md"


@dataclass(frozen=True)
class Trial:
    """One noise seed of a case, its posterior found by some methods."""

    case: str
    forced: str
    seed: int
    methods: tuple[str, ...]
    overrides: tuple[str, ...]

    def __call__(self) -> pd.DataFrame:
        """``parameter, error_percent, holds, r_hat, ess_bulk, seconds``, ...: a row for each method and parameter."""
        settings = [f"experiment=paper/pe_2dof_{self.case}", f"excitation.dofs={self.forced}", "noise.seeds=null"]
        config = RunConfig.read(compose_config([*settings, f"seed={self.seed}", *self.overrides]))
        prepared, run = prepare_problem(config), RunContext(seed=self.seed)
        problem = prepared.problem
        estimate = config.estimator.solve(problem, run)
        assert estimate.likelihoods is not None
        tables = []
        for method in self.methods:
            start = time.process_time()
            samples = draws(method, estimate.likelihoods, problem, run)
            seconds = time.process_time() - start
            table = scored(samples, problem.alone.uncertain, prepared.truth)
            tables.append(table.assign(method=method, seconds=seconds))
        return pd.concat(tables).assign(case=f"{CASES[self.case]}, {FORCED[self.forced]}", seed=self.seed)


def draws(method: str, found: ParameterLikelihoods, problem: JointProblem, run: RunContext) -> PosteriorSamples:
    """A posterior found in one of the ways."""
    assert problem.priors
    ways = {"marginal": Marginal, "conditional": Conditional}
    likelihood = found.conditional if method.startswith("conditional") else found.marginal
    return ways.get(method, Laplace)().sample(likelihood, problem.priors, run)


def scored(samples: PosteriorSamples, parameters: Sequence[Parameter], truth: Truth) -> pd.DataFrame:
    """Diagnostics of the parameters with their error and whether the 90 % interval holds the truth."""
    table = diagnose(samples)
    table = table[table["parameter"].isin(samples.names)].copy()
    true = np.array([true_value(parameter, truth.parameters) for parameter in parameters])
    table["error_percent"] = 100.0 * np.abs(table["mean"] / true - 1.0)
    table["holds"] = (table["lower_90"] <= true) & (true <= table["upper_90"])
    table["divergent"] = int(np.sum(samples.statistics.get("diverging", 0)))
    return table


def coverage(found: pd.DataFrame) -> str:
    """By case: errors of damping, stiffness and the law, and the share of intervals that hold; Markdown."""
    rows = []
    for case, own in found.groupby("case", sort=False):
        marginal, conditional = (own[own["method"] == method] for method in GAUSSIAN)
        errors = marginal.groupby("parameter", sort=False)["error_percent"].mean()
        cells = [" ".join(f"{errors[f'{name}_{dof}']:.2g}" for dof in (1, 2)) for name in ("c", "k")]
        law = "kappa" if "kappa_1" in errors.index else "mu"
        cells.append(" ".join(f"{errors[f'{law}_{dof}']:.2g}" for dof in (1, 2)))
        cells += [f"{100.0 * part['holds'].mean():.1f} %" for part in (marginal, conditional)]
        rows.append([case, *cells])
    columns = ["case", "c_1 c_2", "k_1 k_2", "κ_1 κ_2 or μ_1 μ_2", "marginal", "conditional"]
    return markdown(pd.DataFrame(rows, columns=columns))


def sampling(found: pd.DataFrame) -> str:
    """By case and method: intervals that hold, and the worst diagnostics of the chains; Markdown."""
    rows = []
    for (case, method), own in found[found["method"].isin(SAMPLED)].groupby(["case", "method"], sort=False):
        each = own.groupby("seed").agg({"r_hat": "max", "ess_bulk": "min", "ess_tail": "min", "divergent": "max"})
        least = each[["ess_bulk", "ess_tail"]].min(axis=1)
        passed = (each["r_hat"] <= 1.01) & (least >= 400) & (each["divergent"] == 0)
        cells = [f"{100.0 * own['holds'].mean():.1f} %", f"{each['r_hat'].max():.4f}", f"{least.min():.0f}"]
        cells += [str(each["divergent"].sum()), f"{passed.sum()} of {len(each)}", f"{own['seconds'].mean():.1f}"]
        rows.append([case, method, *cells])
    columns = ["case", "posterior", "intervals hold", "R-hat", "draws", "divergences", "runs that pass", "seconds"]
    return markdown(pd.DataFrame(rows, columns=columns))


def main() -> None:
    """Run all cases on all cores, print both tables and write them into the page on request."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.calibration", description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=40, help="of every case")
    parser.add_argument("--sampled", type=int, default=10, help="of these, so many by NUTS, too")
    parser.add_argument("--cases", nargs="*", default=[*CASES], choices=[*CASES])
    parser.add_argument("--forced", nargs="*", default=[*FORCED], choices=[*FORCED])
    parser.add_argument("--write", action="store_true", help="write both tables into docs/method.md")
    parser.add_argument("overrides", nargs="*", help="further settings, as pinn-run takes them (after --)")
    given = parser.parse_args()
    trials = [
        Trial(case, forced, seed, GAUSSIAN + (SAMPLED if seed < given.sampled else ()), tuple(given.overrides))
        for case in given.cases
        for forced in given.forced
        for seed in range(given.seeds)
    ]
    with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
        found = pd.concat(pool.map(call, trials))
    command = " ".join(["make calibration", *[f'ARGS="{" ".join(sys.argv[1:])}"'] * (len(sys.argv) > 1)])
    for name, text in (("calibration", coverage(found)), ("calibration-sampled", sampling(found))):
        print(f"{text}\n", flush=True)
        if given.write:
            write(PAGE, name, text, command)


if __name__ == "__main__":
    main()
