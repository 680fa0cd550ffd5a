"""Which program is judged: this checkout, or another revision of it."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from benchmarks.trust.families.ground import RECORDED

HERE = Path(__file__).parents[2]
JUDGED = ("pinn_cli", "conf", "hydra_plugins")  # what a run consists of
# Modules of this folder that decide no row.
BESIDE = ("__main__.py", "ambient.py", "constants.py", "peers.py", "programs.py", "runner.py", "table.py", "told.py")


def digest(source: Path, overrides: Sequence[str] = ()) -> str:
    """Of all that decides a row: the program that is judged, further settings, the cases, recorded earthquakes."""
    found = hashlib.sha256("\n".join(overrides).encode())
    paths = [path for name in JUDGED for path in (source / name).rglob("*") if path.suffix in (".py", ".yaml")]
    cases = [path for path in (HERE / "benchmarks" / "trust").rglob("*.py") if path.name not in BESIDE]
    for path in sorted(paths) + sorted(cases):
        found.update(
            str(path.relative_to(source if path.is_relative_to(source) else HERE)).encode() + path.read_bytes()
        )
    for path in sorted(RECORDED.glob("*.csv")):  # none where there are no recordings beside the checkout
        found.update(path.name.encode() + path.read_bytes())
    return found.hexdigest()[:12]


def of_revision(name: str, trees: Path) -> Path:
    """A revision's files, below `trees`."""
    commit = subprocess.run(
        ["git", "rev-parse", "--verify", f"{name}^{{commit}}"], cwd=HERE, capture_output=True, text=True, check=True
    ).stdout.strip()
    tree = trees / commit[:12]
    if not tree.is_dir():
        beside = trees / f".{commit[:12]}"
        shutil.rmtree(beside, ignore_errors=True)
        beside.mkdir(parents=True)
        archive = subprocess.run(["git", "archive", commit], cwd=HERE, capture_output=True, check=True).stdout
        subprocess.run(["tar", "-x", "-C", str(beside)], input=archive, check=True)
        conf = beside / "pinn_cli" / "conf"
        if not conf.exists() and not conf.is_symlink():
            conf.symlink_to("../conf")
        beside.rename(tree)
    return tree
