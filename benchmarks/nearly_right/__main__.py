"""The program against an output-error fit on machines that are nearly what the model says: `make bench-nearly-right`.

Twelve kinds of small error, ten records of one machine each: the first half of a record is fitted, the second one is
simulated with what was found, from the first state that suits it best. Printed for each kind:

    missed      NMSE there, %, median of the records, ours and the output-error fit's
    ratio       of ours to the fit's, median and worst
    m, c, k     errors of the parameters, %, median, ours and the fit's; `+-`: half of our 90 % intervals, %
    overlap     share of pairs of records whose 90 % intervals overlap, %, of all m, c and k
    sound       records whose verdict is sound; `wrongly`: those of them that miss more than 5 %
    named       records whose reasons name what is missing

Rows go to a CSV file as they are done, and a command that is called again goes on there.
"""

from __future__ import annotations

import argparse
import csv
import json
import re
import subprocess
import sys
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

from benchmarks.nearly_right.machines import KINDS, Measured
from benchmarks.nearly_right.output_error import fitted, missed_percent
from benchmarks.nearly_right.record import write

SOUND_WITHIN = 5.0  # NMSE of a free run, %
FIRST_PERIODS = 4.0  # of the fit's first piece


def rows(kind: str, record: int, overrides: Sequence[str]) -> pd.DataFrame:
    """A row for each parameter of a record, with what the run and the fit did in all of them."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        truth = write(folder, kind, record)
        command = [
            sys.executable, "-m", "pinn_cli.main", "--config-dir", str(folder), "experiment=machine", "figures=false",
            f"hydra.run.dir={folder / 'run'}", *overrides,
        ]  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        table = pd.DataFrame({"parameter": truth.model.names, "true": truth.true})
        found = folder / "run" / "parameters.csv"
        told = {"verdict": f"status {done.returncode}", "reasons": [done.stderr[-300:]], "seconds": {}}
        if done.returncode == 0:
            told = json.loads((folder / "run" / "run.json").read_text(encoding="utf-8"))
            ours = pd.read_csv(found)[["parameter", "estimate", "lower_90", "upper_90"]]
            table = table.merge(ours, on="parameter", how="left")
        else:
            table = table.assign(estimate=np.nan, lower_90=np.nan, upper_90=np.nan)
    half, dt = truth.half, 1.0 / truth.machine.rate
    first = round(FIRST_PERIODS / truth.machine.frequencies[0] / dt)
    table["fit"], _ = fitted(truth.model, truth.guess, truth.force[:half], truth.sensors[:half], dt, first)
    return table.assign(
        kind=kind,
        record=record,
        verdict=told["verdict"],
        missed=unseen(truth, table["estimate"].to_numpy()),
        fit_missed=unseen(truth, table["fit"].to_numpy()),
        reasons=" | ".join(told["reasons"]),
        seconds=told["seconds"].get("total", np.nan),
    )


def unseen(truth: Measured, p: np.ndarray) -> float:
    """NMSE, %, of parameters on the second half; NaN where one is missing."""
    half = truth.half
    if not np.all(np.isfinite(p)):
        return np.nan
    return missed_percent(truth.model, p, truth.force[half:], truth.sensors[half:], 1.0 / truth.machine.rate)


def overlap_percent(table: pd.DataFrame) -> float:
    """Share of pairs of records, of all m, c and k, whose intervals overlap, %."""
    pairs = [
        one.lower_90 <= other.upper_90 and other.lower_90 <= one.upper_90
        for name, part in table.groupby("parameter")
        if str(name)[0] in "mck"
        for one, other in combinations(part.dropna(subset=["lower_90", "upper_90"]).itertuples(), 2)
    ]
    return 100.0 * float(np.mean(pairs)) if pairs else np.nan


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """A row for each kind."""
    lines = []
    for kind, part in table.groupby("kind", sort=False):
        runs = part.groupby("record").first()
        line: dict[str, object] = {"kind": kind, "records": len(runs)}
        line |= {"missed": runs["missed"].median(), "fit": runs["fit_missed"].median()}
        ratio = runs["missed"] / runs["fit_missed"]
        line |= {"ratio": ratio.median(), "worst": ratio.max()}
        for letter in "mck":
            of = part[part["parameter"].str.match(f"{letter}_")]
            line[letter] = (100.0 * (of["estimate"] / of["true"] - 1.0)).abs().median()
            line[f"+- {letter}"] = (50.0 * (of["upper_90"] - of["lower_90"]) / of["estimate"]).median()
            line[f"fit's {letter}"] = (100.0 * (of["fit"] / of["true"] - 1.0)).abs().median()
        sound = runs["verdict"] == "sound"
        line |= {"overlap": overlap_percent(part), "sound": int(sound.sum())}
        line["wrongly"] = int((sound & ~(runs["missed"] <= SOUND_WITHIN)).sum())
        line["failed"] = int((runs["verdict"] == "failed").sum())
        named = runs["reasons"].fillna("").str.contains(KINDS[str(kind)].names, flags=re.IGNORECASE)
        line["named"] = int(named.sum())
        line["seconds"] = runs["seconds"].median()
        lines.append(line)
    return pd.DataFrame(lines)


def told(table: pd.DataFrame) -> str:
    """The table of `summary` and what all kinds reach, in text."""
    kinds = summary(table)
    with pd.option_context("display.width", 250, "display.max_columns", None):
        text = kinds.to_string(index=False, float_format=lambda value: f"{value:.3g}")
    near = int((kinds["ratio"] <= 1.1).sum())
    agreed = int(kinds["overlap"].between(80.0, 97.0).sum())
    named = int((2 * kinds["named"] > kinds["records"]).sum())
    return (
        f"{text}\n\nof {len(kinds)} kinds: free run at most 1.1 times the fit's in {near}, intervals overlap in 80 to"
        f" 97 % of pairs in {agreed}, the missing term is named in {named}; {kinds['wrongly'].sum()} of"
        f" {kinds['records'].sum()} records are wrongly sound"
    )


def main() -> None:
    """Run what is missing, and print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.nearly_right", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="two records of each kind")
    parser.add_argument("--records", type=int, default=10, help="records of each kind")
    parser.add_argument("--kinds", nargs="*", default=[kind for kind in KINDS if kind != "none"], choices=tuple(KINDS))
    parser.add_argument("--csv", type=Path, default=Path("outputs/nearly_right.csv"), help="where the rows go")
    parser.add_argument("overrides", nargs="*", help="further settings, as pinn-run takes them (after --)")
    given = parser.parse_args()
    given.csv.parent.mkdir(parents=True, exist_ok=True)
    done = set()
    if given.csv.is_file():
        done = set(pd.read_csv(given.csv)[["kind", "record"]].itertuples(index=False, name=None))
    for record in range(2 if given.quick else given.records):
        for kind in given.kinds:
            if (kind, record) in done:
                continue
            part = rows(kind, record, given.overrides)
            part.to_csv(given.csv, mode="a", header=not given.csv.is_file(), index=False, quoting=csv.QUOTE_MINIMAL)
            run = part.iloc[0]
            print(
                f"{kind} {record}: {run['verdict']}, misses {run['missed']:.3g} %, fit {run['fit_missed']:.3g} %",
                flush=True,
            )
    table = pd.read_csv(given.csv)
    print(told(table[table["kind"].isin(given.kinds)]))


if __name__ == "__main__":
    main()
