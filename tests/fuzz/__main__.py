"""`make fuzz`: inputs of every family tried, counted, and kept where they fail.

    make fuzz ARGS="--each 90 --seed 1 --family csv"

Prints a table and writes it to outputs/fuzz.csv. What fails lies in outputs/fuzz/, one file an input: mend it, move the
file to tests/fuzz/corpus, and `make test` replays it for ever.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from statistics import median

import pandas as pd
from fuzz import directories, files, overrides
from fuzz.judge import Judge, Outcome, import_everything
from fuzz.trial import Starts, Trial
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

FAMILIES: dict[str, st.SearchStrategy[Trial]] = {
    "options": overrides.options(),
    "numbers": overrides.numbers(),
    "csv": files.csv(),
    "yaml": files.yaml(),
    "resume": files.resume(),
    "disk": files.disk(),
    "physics": overrides.physics(),
    "directories": directories.directories(),
    "terminal": directories.terminal(),
    "bombs": files.bombs(),
    "launchers": overrides.launchers(),
}
# Of each family so many go through the real executable.
BY_EXECUTABLE = 3
COLUMNS = ("family", "tried", "passed", "refused", "results", "diverged", "median_s", "longest_s")
ROOT = Path(__file__).parents[2]


def tried(family: str, count: int, number: int, call: Callable[[Trial], None]) -> None:
    """Call a function with so many different inputs of a family."""
    seen: set[str] = set()

    every = {"phases": [Phase.generate], "database": None, "deadline": None, "suppress_health_check": list(HealthCheck)}

    @seed(number)
    @settings(max_examples=2 * count, **every)
    @given(FAMILIES[family])
    def each(trial: Trial) -> None:
        if trial.name in seen or len(seen) == count:
            return
        seen.add(trial.name)
        call(trial)

    each()


def row(family: str, count: int, number: int, judge: Judge, failed: Path) -> dict[str, object]:
    """Try a family; its row of the table."""
    outcomes: list[Outcome] = []
    faults = 0

    def call(trial: Trial) -> None:
        nonlocal faults
        outcome = judge.outcome(trial, executable=len(outcomes) < BY_EXECUTABLE)
        outcomes.append(outcome)
        if fault := outcome.fault(trial):
            faults += 1
            failed.mkdir(parents=True, exist_ok=True)
            (failed / f"{trial.name}.json").write_text(trial.text(), encoding="utf-8")
            print(f"{trial.name}: {fault}\n  pinn-run {' '.join(trial.arguments)[:300]}", flush=True)
            print("".join(f"  | {line[:200]}\n" for line in outcome.err.splitlines()[-4:]), end="", flush=True)

    tried(family, count, number, call)
    seconds = [outcome.seconds for outcome in outcomes]
    of = {status: sum(outcome.status == status for outcome in outcomes) for status in (0, 2, 3)}
    counts = (len(outcomes), len(outcomes) - faults, of[2], of[0], of[3])
    times = round(median(seconds), 2), round(max(seconds), 2)
    return dict(zip(COLUMNS, (family, *counts, *times), strict=True))


def main() -> int:
    """Try every family, print the table; 1 where an input failed."""
    parser = argparse.ArgumentParser(prog="make fuzz", description="bad inputs of every family, counted")
    parser.add_argument("--each", type=int, default=90, help="inputs of each family")
    parser.add_argument("--seed", type=int, default=0, help="of the inputs")
    parser.add_argument("--family", choices=FAMILIES, action="append", help="only this one; may be given again")
    parser.add_argument("--limit", type=float, default=240.0, help="seconds that one input may take")
    given_ = parser.parse_args()
    import_everything()
    rows = []
    with tempfile.TemporaryDirectory(prefix="fuzz-starts-") as kept:
        judge = Judge(Starts(Path(kept)), given_.limit)
        for family in given_.family or FAMILIES:
            rows.append(row(family, given_.each, given_.seed, judge, ROOT / "outputs" / "fuzz"))
            print("  ".join(f"{name}={value}" for name, value in rows[-1].items()), flush=True)
    table = pd.DataFrame(rows, columns=COLUMNS)
    table.to_csv(ROOT / "outputs" / "fuzz.csv", index=False)
    tried_all, passed = table["tried"].sum(), table["passed"].sum()
    print(f"{passed} of {tried_all} passed")
    return int(passed < tried_all)


if __name__ == "__main__":
    sys.exit(main())
