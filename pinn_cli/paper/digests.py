"""Whether a run that lies there is still the one that would be made: what it depends on, as one digest."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

from omegaconf import OmegaConf

from pinn_cli.cli.prepare import compose_config
from pinn_cli.report.run_record import package_versions
from pinn_cli.runs.writing import write_json

if TYPE_CHECKING:
    from collections.abc import Sequence

FINISHED = "finished.json"
# Read what runs have left, and are no part of one: a better caption is no reason to run everything again.
READERS = ("paper", "report/published.py")


def run_digest(overrides: Sequence[str]) -> str:
    """SHA-256 of the composed configuration, the code and the versions that a run with these overrides depends on.

    Raises:
        hydra.errors.HydraException: The overrides do not compose.
    """
    parts = (_composed(tuple(overrides)), source_digest(), json.dumps(package_versions(), sort_keys=True))
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


@cache  # composing takes a tenth of a second
def _composed(overrides: tuple[str, ...]) -> str:
    return OmegaConf.to_yaml(compose_config(overrides))


@cache
def source_digest() -> str:
    """SHA-256 of the package's modules and configs, without `READERS`."""
    package, conf = (Path(str(resources.files(name))) for name in ("pinn_cli", "pinn_cli.conf"))
    return tree_digest(package, "*.py", READERS) + tree_digest(conf, "*.yaml")


def tree_digest(root: Path, pattern: str, left_out: Sequence[str] = ()) -> str:
    """SHA-256 of the names and contents of files in a folder and its own folders.

    Args:
        root: The folder.
        pattern: Of the files' names.
        left_out: Files and folders that do not count, as paths from the root.
    """
    names = {file.relative_to(root).as_posix(): file for file in sorted(root.rglob(pattern))}
    # The digest of each file, not its bytes: no content can pass for a name.
    lines = [
        f"{name}\0{file_digest(file)}\n"
        for name, file in names.items()
        if not any(f"{name}/".startswith(f"{part}/") for part in left_out)
    ]
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def file_digest(file: Path) -> str:
    """SHA-256 of a file's content."""
    return hashlib.sha256(file.read_bytes()).hexdigest()


def mark_finished(directory: Path, digest: str, process_seconds: float) -> None:
    """Write `FINISHED`, whole or not at all: the last act of a run."""
    write_json({"digest": digest, "process_seconds": process_seconds}, directory / FINISHED)


def finished_run(directory: Path, digest: str) -> float | None:
    """The seconds of a run that `mark_finished` marked under this digest; None where it is to be made (again)."""
    try:
        content = json.loads((directory / FINISHED).read_text(encoding="utf-8"))
        return float(content["process_seconds"]) if content["digest"] == digest else None
    except (OSError, ValueError, KeyError, TypeError):
        return None
