"""Bad input, through the whole program: one line, exit status 2, and a folder as it was before."""

import pickle
import subprocess
import sys
from pathlib import Path

import pytest
from calls import PinnRun

from pinn_cli.settings.errors import InputError

HEADER = "t,f1,a1,a2\n"
COLUMNS = ("data.time=t", "data.force={1: f1}", "data.acceleration={1: a1, 2: a2}", "system.ndof=2")


def rows(count: int, step: float = 0.01) -> list[str]:
    return [f"{i * step:.4f},{i % 7},{i % 5},{i % 3}\n" for i in range(count)]


FILES = {
    "no file": (None, ["rig.csv"]),
    "empty file": ([], ["rig.csv"]),
    "missing column": (["t,f1,a1\n", *(f"{i / 100},0,1\n" for i in range(64))], ["a2", "rig.csv"]),
    "time going back": ([HEADER, *rows(40), *rows(64)[20:]], ["rig.csv", "t", "42"]),
    "empty column": ([HEADER, *(row.rpartition(",")[0] + ",\n" for row in rows(90))], ["data.acceleration", "a2"]),
    "text": ([HEADER, *rows(40), "0.4000,1,1,broken\n", *rows(90)[41:]], ["rig.csv", "a2", "42"]),
    "too few samples": ([HEADER, *rows(9)], ["rig.csv"]),
}


@pytest.mark.parametrize(("lines", "told"), FILES.values(), ids=FILES.keys())
def test_files(pinn_run: PinnRun, tmp_path: Path, lines: list[str] | None, told: list[str]) -> None:
    if lines is not None:
        (tmp_path / "rig.csv").write_text("".join(lines))
    before = sorted(tmp_path.rglob("*"))
    pinn_run("data=csv", "data.path=rig.csv", *COLUMNS).refused(*told)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_process_ends_with_2(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "pinn_cli.main", "system.ndof=0"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert done.stderr.startswith("pinn-run: system.ndof=0: must be")
    assert list(tmp_path.iterdir()) == []


def test_an_error_crosses_processes_and_is_cut() -> None:
    error = InputError("system.ndof", 0, ">= 1", "a chain has a mass")
    assert str(pickle.loads(pickle.dumps(error))) == "system.ndof=0: must be >= 1; a chain has a mass"
    told = str(InputError("case", "a" * 6000, "a name", "b" * 6000))
    assert told.startswith(f"case={'a' * 500}... (6000 characters): must be a name; bbb")
    assert len(told) < 1100
