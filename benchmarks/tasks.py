"""Seconds of what people do, and where they go: `make bench-tasks`.

Random structures of the referee's families, made by other code, are estimated one by one, each in a process and on a
thread of its own. Printed for each task, in seconds of the processor:

    s           of the whole command less what it takes to start, median and worst
    MiB         peak of the process, worst
    shares      of these seconds, %: screening of starts; the first solution, from every start and soft to stiff; pull
                of the marginal likelihood; the other stories (free run and smooth force); the posterior of the motion;
                sampling; what the model may lack; all further steps; the rest, tables and verdict
    output error, Kalman filter
                of `scipy.optimize.least_squares` on the simulated linear structure, and of a joint filter for state and
                parameters, where they can do the task; median (with --peers: many minutes for the filter)
    missed      errors of the parameters, %, median of their root mean squares, ours and the fit's

Rows go to a CSV file as they are done, and a command that is called again goes on there.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

from benchmarks.__main__ import counted
from benchmarks.trust.families import drawn
from benchmarks.trust.peers import compared

TASKS = {
    "chain": "chain, c and k unknown",
    "topology": "braced structure, c and k unknown",
    "ground": "earthquake, c and k unknown",
    "nonlinear": "nonlinear connection, its parameters unknown",
    "finite_elements": "finite elements, stiffness factors unknown",
    "sensors": "sensors with unknown calibration",
    "posterior": "posterior samples (NUTS, two chains of 500 + 500)",
}
OPTIONS = {"posterior": ("posterior.chains=2", "posterior.warmup=500", "posterior.draws=500")}
STARTING = ("before", "config", "imports")  # stages that no task is about
# Shares, and the stages and steps that they are of.
PARTS = {
    "screening": ("problem",),
    "first solution": ("step_identify_by_spectra", "step_first_solution"),
    "marginal peak": ("step_move_to_marginal_peak",),
    "other stories": ("step_fit_free_run", "step_fit_smooth_force"),
    "motion": ("step_posterior_estimate",),
    "sampling": ("posterior",),
    "lacking": ("step_doubts",),
}


def row(family: str, seed: int, peers: bool) -> dict[str, float | str]:
    """What one case took, and how near it came, beside its peers."""
    case = drawn(family, seed)
    with TemporaryDirectory() as name:
        folder = Path(name)
        case.write(folder)
        command = ["--config-dir", str(folder), f"experiment={case.name}", "figures=false", *OPTIONS.get(family, ())]
        took = counted(command, folder / "run")
        table = pd.read_csv(folder / "run" / "parameters.csv").set_index("parameter")["estimate"]
    starting = sum(took.get(f"{stage}_cpu_s", 0.0) for stage in STARTING)
    seconds = took["cpu_s"] - starting
    found: dict[str, float | str] = {"family": family, "seed": seed, "about": case.about, "s": seconds}
    found |= {"MiB": took["memory_mib"], "missed": missed(table, case.truth.parameters)}
    parts = {part: sum(took.get(f"{name}_cpu_s", 0.0) for name in names) for part, names in PARTS.items()}
    named = {f"{name}_cpu_s" for names in PARTS.values() for name in names}
    further = (value for name, value in took.items() if name.startswith("step_") and name not in named)
    parts |= {"further steps": sum(further)}
    parts |= {"rest": seconds - sum(parts.values())}
    found |= {part: 100.0 * value / seconds for part, value in parts.items()}
    for peer, by_peer in compared(case).groupby("peer") if peers else ():
        of_peer = by_peer.set_index("parameter")["estimate"]
        found |= {
            str(peer): float(by_peer["seconds"].iloc[0]),
            f"{peer} missed": missed(of_peer, case.truth.parameters),
        }
    return found


def missed(table: pd.Series, truth: dict[str, float]) -> float:
    """Root mean square of the relative errors of the parameters that a table has, %."""
    off = [table[name] / value - 1.0 for name, value in truth.items() if name in table.index and value]
    return 100.0 * float(np.sqrt(np.mean(np.square(off)))) if off else np.nan


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """A row for each task, as texts."""
    rows = []
    for family, part in table.groupby("family", sort=False):

        def median(name: str, digits: int = 2, of: pd.DataFrame = part) -> str:
            value = of[name].median() if name in of else np.nan
            return "" if np.isnan(value) else f"{value:.{digits}g}"

        line = {
            "task": TASKS[str(family)],
            "s": f"{median('s')} ({part['s'].max():.2g})",
            "MiB": f"{part['MiB'].max():.0f}",
        }
        line |= {name: f"{part[name].mean():.0f}" for name in (*PARTS, "further steps", "rest")}
        line |= {"missed, %": median("missed")}
        for peer in (name for name in ("output error", "Kalman filter") if name in table):
            line |= {f"{peer}, s": median(peer), f"{peer} missed, %": median(f"{peer} missed")}
        rows.append(line)
    return pd.DataFrame(rows)


def main() -> None:
    """Run what is missing, and print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.tasks", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=5, help="cases of each task")
    parser.add_argument("--only", nargs="*", default=list(TASKS), choices=tuple(TASKS), help="these tasks")
    parser.add_argument("--peers", action="store_true", help="other estimators of the same cases, too")
    parser.add_argument("--csv", type=Path, default=Path("outputs/bench/tasks.csv"), help="where the rows go")
    given = parser.parse_args()
    given.csv.parent.mkdir(parents=True, exist_ok=True)
    table = pd.read_csv(given.csv) if given.csv.is_file() else pd.DataFrame({"family": [], "seed": []})
    done = set(zip(table["family"], table["seed"], strict=True))
    for family in given.only:
        for seed in (seed for seed in range(given.seeds) if (family, seed) not in done):
            found = row(family, seed, given.peers)
            table = pd.concat([table, pd.DataFrame([found])], ignore_index=True)
            table.to_csv(given.csv, index=False, float_format="%.6g")
            print(f"{family} {seed}: {found['s']:.1f} s", flush=True)
    told = summary(table[table["family"].isin(given.only)])
    print(told.to_string(index=False))
    print(given.csv)


if __name__ == "__main__":
    main()
