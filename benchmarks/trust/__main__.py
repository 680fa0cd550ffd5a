"""How often is the program right? `make trust`.

Random structures of many families, made with numpy and scipy alone, are estimated by the real command, in its own
sweeps, and compared with the truth:

    make trust                                            some 600 cases: hours on two cores
    make trust ARGS=--quick                               60 cases: at most 20 minutes
    make trust ARGS="--family ground --seeds 20"          one family
    make trust ARGS="--seeds 12 --first 500"              structures that nobody has looked at
    make trust ARGS="--family ground --seed 7"            one case, whose files stay
    make trust ARGS="--quick --against REVISION"          the same cases on two revisions: what changed, case by case
    make trust ARGS="--vary training/beginning.TIE"  the quick cases with a number halved and doubled
    make trust ARGS="--vary all"                          every number of the estimator, three cases each (hours)
    make trust ARGS="--write"                             the table and the figure go to docs/trust.md

Rows lie in outputs/trust/DIGEST, where the digest is that of the program and of the cases. A command that is called
again goes on there.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

import pandas as pd

from benchmarks.trust.constants import Trial, constants, varied
from benchmarks.trust.families import FAMILIES
from benchmarks.trust.programs import HERE, digest, of_revision
from benchmarks.trust.runner import PARAMETERS, Drawn, Referee
from benchmarks.trust.score import OUTCOMES
from benchmarks.trust.table import Judged, by_family, by_peers, changes, coverage, draw, outcomes, worst
from benchmarks.written import write

FULL, QUICK = 55, 5  # cases of a family
QUICK_SPOILT = 10  # of the family of faults, which stands for all others
# Where every constant is varied: of each family so many quick cases with something to identify, those that take the
# least time; and so many of these for each constant.
CHEAP, FEW = 2, 3
CONSTANTS = "constants.csv"
PAGE = HERE / "docs" / "trust.md"


def wanted(given: argparse.Namespace) -> list[Drawn]:
    """Families and seeds that the options ask for."""
    families = given.family or FAMILIES
    if given.seed is not None:
        return [(family, given.seed) for family in families]
    found: list[Drawn] = []
    for family in families:
        number = given.seeds or (QUICK_SPOILT if given.quick and family == "spoilt" else QUICK if given.quick else FULL)
        found += [(family, seed) for seed in range(given.first, given.first + number)]
    return found


def referee(source: Path, given: argparse.Namespace) -> Referee:
    """Of one program. A single case has a folder of its own, which stays."""
    single = given.seed is not None
    name = "_".join([*(given.family or ["all"]), str(given.seed)]) if single else digest(source, given.overrides)
    return Referee(given.folder.resolve() / name, source, given.launcher, tuple(given.overrides), single)


def judged(source: Path, given: argparse.Namespace) -> Judged:
    """Rows and parameters of all wanted cases by one program."""
    own = referee(source, given)
    if own.keep:  # whatever program it was made with
        shutil.rmtree(own.folder, ignore_errors=True)
    rows = own.run(wanted(given))
    print(f"{own.folder}")
    parameters = pd.read_csv(own.folder / PARAMETERS)
    return Judged(rows, parameters[parameters["case"].isin(rows["case"])])


def compared(source: Path, given: argparse.Namespace, against: Path) -> pd.DataFrame:
    """Print what changes from one program to another, and return the changed cases."""
    before, after = judged(against, given), judged(source, given)
    for name, rows in (("before", before.rows), ("after", after.rows)):
        counts = ", ".join(f"{int((rows['outcome'] == outcome).sum())} {outcome}" for outcome in OUTCOMES)
        print(f"{name}: {counts}; {rows['seconds'].sum():.0f} s")
    found = changes(before, after)
    print(found.to_string(index=False, float_format=lambda x: f"{x:.3g}") if len(found) else "no case changed")
    return found


def vary(given: argparse.Namespace) -> pd.DataFrame:
    """What named constants do to all quick cases; `all` of them to a few. A killed command goes on where it was."""
    every, asked = given.vary == ["all"], set(given.vary)
    chosen = [one for one in constants() if every or {one.label, one.name} & asked]
    if not chosen:
        sys.exit(f"--vary: no {', '.join(given.vary)}; they are called training/beginning.TIE and the like")
    given.quick = True
    known = judged(HERE, given).rows.dropna(subset="seconds").sort_values("seconds")
    path = referee(HERE, given).folder / CONSTANTS
    if every:
        known = known.dropna(subset="worst_parameter").groupby("family").head(CHEAP)
    cases = [Trial(*of) for of in known[["family", "seed", "seconds"]].itertuples(index=False)]
    table = pd.read_csv(path) if every and path.is_file() else pd.DataFrame()
    done = set() if table.empty else set(table["constant"])
    missing = [one for one in chosen if one.label not in done]
    for rows in varied(missing, cases, FEW if every else len(cases)):
        table = rows if table.empty else pd.concat([table, rows], ignore_index=True)
        if every:
            table.to_csv(path, index=False)
        print(rows.to_string(index=False, header=False), flush=True)
    if every and given.write:
        shutil.copyfile(path, Path(__file__).with_name(CONSTANTS))
    return table


def main() -> None:
    """Run what is missing and print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.trust", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="60 cases")
    parser.add_argument("--family", nargs="*", choices=FAMILIES, help="these alone")
    parser.add_argument("--seeds", type=int, help="cases of each family")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="the first of each family (default 0)")
    parser.add_argument("--seed", type=int, help="this one alone; its files stay")
    parser.add_argument("--against", metavar="REVISION", help="compare with this revision")
    parser.add_argument("--vary", nargs="+", metavar="CONSTANT", help="halve and double; all: every one of them")
    parser.add_argument("--peers", action="store_true", help="other methods on the same cases, too")
    parser.add_argument("--write", action="store_true", help="write docs/trust.md")
    parser.add_argument("--folder", type=Path, default=Path("outputs/trust"), help="where the rows go")
    parser.add_argument("--launcher", default="joblib", help="of the sweeps: joblib, slurm, ray_cluster, ...")
    parser.add_argument("overrides", nargs="*", help="further settings, as pinn-run takes them (after --)")
    given = parser.parse_args()
    if given.vary:
        print(vary(given).to_string(index=False))
        return
    if given.against:
        compared(HERE, given, of_revision(given.against, given.folder / "trees"))
        return
    found = judged(HERE, given)
    table = by_family(found)
    told = {"trust-outcomes": outcomes(table), "trust-coverage": coverage(table)}
    if given.peers:
        told["trust-peers"] = by_peers(found, referee(HERE, given).peers(wanted(given)))
    print("\n\n".join([worst(found.rows), *told.values()]))
    if given.write:
        options = " ".join(argument for argument in sys.argv[1:] if argument != "--write")
        command = f'make trust ARGS="{options} --write"'.replace('" ', '"')
        for name, text in told.items():
            write(PAGE, name, text, command)
        write(PAGE, "trust-worst", "\n".join(f"- {line}" for line in worst(found.rows).splitlines()), command)
        draw(table, PAGE.with_suffix(".png"))


if __name__ == "__main__":
    main()
