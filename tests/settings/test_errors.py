"""Bad input, through the whole program: one line, exit status 2, and a folder as it was before."""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path

import pytest
from calls import PinnRun

from pinn_cli.settings.errors import InputError

HEADER = "t,f1,a1,a2\n"
CSV = [
    "data=csv",
    "data.path=rig.csv",
    "data.time=t",
    "data.force={1: f1}",
    "data.acceleration={1: a1, 2: a2}",
    "system.ndof=2",
]


def rows(count: int, step: float = 0.01) -> list[str]:
    return [f"{i * step:.4f},{i % 7},{i % 5},{i % 3}\n" for i in range(count)]


SETTINGS = {
    "ndof below 1": (["system.ndof=0"], "system.ndof=0"),
    "wrong list length": (["system.k=[1,2,3]"], "system.k=[1"),
    "SNR not finite": (["noise.snr_db=inf"], "noise.snr_db=inf"),
    "all DOFs unobserved": (["scheme.unobserved=[1,2,3,4,5,6]"], "scheme.unobserved="),
    "band above Nyquist": (["excitation.band=[1,50]"], "excitation.band="),
    "record too short for its band": (["simulation.duration=2", "excitation.band=[0.05,0.3]"], "excitation.band="),
    "another package's target": (["scheme._target_=os.system"], "scheme._target_=os.system"),
    "no such CUDA device": (["device=cuda:99"], "device=cuda:99"),
    "training without iterations": (["training.iterations=0"], "training.iterations=0"),
}


@pytest.mark.parametrize(("overrides", "told"), SETTINGS.values(), ids=SETTINGS.keys())
def test_settings(pinn_run: PinnRun, tmp_path: Path, overrides: list[str], told: str) -> None:
    outcome = pinn_run(*overrides)
    assert (outcome.status, outcome.err.count("\n")) == (2, 1)
    assert outcome.err.startswith(f"pinn-run: {told}")
    assert list(tmp_path.iterdir()) == []


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
    outcome = pinn_run(*CSV)
    assert (outcome.status, outcome.err.count("\n")) == (2, 1), outcome.err
    for part in told:
        assert part in outcome.err
    assert sorted(tmp_path.rglob("*")) == before


def test_a_process_ends_with_2(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "pinn_cli.main", "system.ndof=0"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("pinn-run: system.ndof=0: must be a whole number")
    assert done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_input_errors_cross_processes() -> None:
    error = InputError("system.ndof", 0, ">= 1", "a chain has a mass")
    copy = pickle.loads(pickle.dumps(error))
    assert str(copy) == str(error) == "system.ndof=0: must be >= 1; a chain has a mass"


def test_a_long_value_is_cut() -> None:
    told = str(InputError("case", "a" * 6000, "a name", "b" * 6000))
    assert told.startswith(f"case={'a' * 500}... (6000 characters): must be a name; bbb")
    assert len(told) < 1100
