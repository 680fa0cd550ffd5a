"""From cases to rows: the program's own sweeps, wave by wave, going on where a kill left them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import pandas as pd

from benchmarks.trust.case import Case
from benchmarks.trust.families import drawn
from benchmarks.trust.peers import compared
from benchmarks.trust.score import Scored, scored

ENDED_BY_SIGNAL = 128  # and the signal: what a shell makes of it
WAVE = 32  # cases whose files lie on the disk at once
ROWS, PARAMETERS, PEERS = "trust.csv", "parameters.csv", "peers.csv"
ALONE = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}

Drawn = tuple[str, int]  # family and seed


@dataclass(frozen=True)
class Referee:
    """Where cases are run, and by which program.

    Attributes:
        folder: Of the tables and, while a wave runs, of its cases and runs.
        source: The checkout whose `pinn_cli` runs.
        launcher: Of the sweeps: joblib, slurm, ray_local, ...
        overrides: Further settings of every run and of the launcher.
        keep: Whether cases and runs stay.
    """

    folder: Path
    source: Path
    launcher: str = "joblib"
    overrides: tuple[str, ...] = ()
    keep: bool = False

    def run(self, wanted: Sequence[Drawn]) -> pd.DataFrame:
        """Rows of all that is wanted, in that order. What the tables have already is not run again."""
        self.folder.mkdir(parents=True, exist_ok=True)
        rows = self._read(ROWS)
        done = set() if rows.empty else set(zip(rows["family"], rows["seed"], strict=True))
        missing = [one for one in wanted if one not in done]
        for start in range(0, len(missing), WAVE):
            for found in self._wave(missing[start : start + WAVE]):
                self._append(PARAMETERS, found.parameters.assign(case=str(found.row["case"])))
                self._append(ROWS, pd.DataFrame([found.row]))
                print(f"{found.row['case']}: {found.row['outcome']}", flush=True)
        order = {one: i for i, one in enumerate(wanted)}
        rows = self._read(ROWS)
        at = [order.get(one, -1) for one in zip(rows["family"], rows["seed"], strict=True)]
        return rows.assign(at=at).query("at >= 0").sort_values("at").drop(columns="at").reset_index(drop=True)

    def peers(self, wanted: Sequence[Drawn]) -> pd.DataFrame:
        """Estimates of other methods for the same cases, of those that they can do."""
        table = self._read(PEERS)
        done = set() if table.empty else set(zip(table["family"], table["seed"], strict=True))
        missing = [one for one in wanted if one not in done]
        with _pool() as pool:
            for (family, seed), found in zip(missing, pool.map(_by_peers, missing), strict=True):
                # A case that they cannot do is a row without a peer: it need not be asked again.
                rows = found if len(found) else pd.DataFrame({"peer": [""]})
                self._append(PEERS, rows.assign(family=family, seed=seed))
        return self._read(PEERS)

    def _wave(self, wanted: Sequence[Drawn]) -> Iterator[Scored]:
        cases, runs = self.folder / "cases", self.folder / "runs"
        drawing = draw(wanted, cases)
        names = [case.name for case in drawing]
        before = [f"{case.name}_before" for case in drawing if case.before is not None]
        if before:
            for name, (directory, _) in self._sweep(before, cases, self.folder / "runs_before").items():
                there = cases / "before" / name.removesuffix("_before")
                if directory.is_dir() and not there.exists():
                    there.parent.mkdir(parents=True, exist_ok=True)
                    shutil.copytree(directory, there)
        ended = self._sweep(names, cases, runs)
        for case in drawing:
            yield scored(case, *ended[case.name])
        if not self.keep:
            for folder in (cases, runs, self.folder / "runs_before"):
                shutil.rmtree(folder, ignore_errors=True)

    def _sweep(self, names: Sequence[str], cases: Path, runs: Path) -> dict[str, tuple[Path, str]]:
        """Directory, and reason of a failure, of every experiment."""
        command = [
            sys.executable, "-m", "pinn_cli.main", "--multirun", "--config-dir", str(cases.resolve()),
            f"hydra/launcher={self.launcher}", f"hydra.sweep.dir={runs.resolve()}", "figures=false",
            f"experiment={','.join(names)}", *self.overrides,
        ]  # fmt: skip
        path = os.pathsep.join(filter(None, [str(self.source.resolve()), os.environ.get("PYTHONPATH", "")]))
        done = subprocess.run(
            command, cwd=self.folder, env=os.environ | ALONE | {"PYTHONPATH": path}, stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
        if done.returncode < 0 or done.returncode > ENDED_BY_SIGNAL:  # what is left of it says nothing of the cases
            sys.exit("the sweep was ended from outside; the same command goes on where it was")
        told = runs / "jobs.csv"
        if not told.is_file():
            # Not one job had usable input, or the sweep itself could not begin.
            return dict.fromkeys(names, (runs / "none", done.stderr.strip()[-600:]))
        jobs = pd.read_csv(told, keep_default_na=False)
        # A sweep of one job has no column for what does not differ.
        experiments = jobs["experiment"] if "experiment" in jobs else names[:1]
        found = dict(zip(experiments, zip(jobs["directory"], jobs["reason"], strict=True), strict=True))
        return {name: (runs / found[name][0], str(found[name][1])) for name in names if name in found} | {
            name: (runs / "none", "the sweep has no such job") for name in names if name not in found
        }

    def _read(self, name: str) -> pd.DataFrame:
        path = self.folder / name
        return pd.read_csv(path, keep_default_na=True) if path.is_file() else pd.DataFrame()

    def _append(self, name: str, rows: pd.DataFrame) -> None:
        """Rows below those that are there, whole or not at all."""
        path, beside = self.folder / name, self.folder / f".{name}"
        joined = pd.concat([self._read(name), rows], ignore_index=True) if path.is_file() else rows
        joined.to_csv(beside, index=False)
        beside.replace(path)


def draw(wanted: Iterable[Drawn], folder: Path) -> list[Case]:
    """Draw cases in processes of their own, and write their files."""
    with _pool() as pool:
        cases = list(pool.map(_drawn, wanted))
    for case in cases:
        case.write(folder)
    return cases


def _pool() -> ProcessPoolExecutor:
    # Forked children of a process that has started threads may hang.
    return ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn"))


def _drawn(wanted: Drawn) -> Case:
    return drawn(*wanted)


def _by_peers(wanted: Drawn) -> pd.DataFrame:
    case = drawn(*wanted)
    return compared(case).assign(case=case.name)
