"""Whether a result that lies there is still the one that would be made: what it depends on, as one digest."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from pinn_cli.cli.composing import compose_config
from pinn_cli.report.run_record import package_versions
from pinn_cli.runs.writing import write_json

# Read what runs have left, and are no part of one: a better caption is no reason to run everything again.
READERS = ("paper/", "report/published.py")


def run_digest(overrides: Sequence[str]) -> str:
    """SHA-256 of the composed configuration, the code and the versions that a run with these overrides depends on.

    Raises:
        hydra.errors.HydraException: The overrides do not compose.
    """
    parts = (_composed(tuple(overrides)), source_digest(), json.dumps(package_versions(), sort_keys=True))
    return digest_of("\0".join(parts))


@cache  # composing takes a tenth of a second
def _composed(overrides: tuple[str, ...]) -> str:
    return OmegaConf.to_yaml(compose_config(overrides))


@cache
def source_digest() -> str:
    """Of the package's modules and configs, without `READERS`."""
    package, conf = (Path(str(resources.files(name))) for name in ("pinn_cli", "pinn_cli.conf"))
    return tree_digest(package, "*.py", READERS) + tree_digest(conf, "*.yaml")


def tree_digest(root: Path, pattern: str, left_out: tuple[str, ...] = ()) -> str:
    """SHA-256 of the names and contents of files in a folder and its own folders.

    Args:
        root: The folder.
        pattern: Of the files' names.
        left_out: How the paths from the root begin that do not count.
    """
    names = {file.relative_to(root).as_posix(): file for file in sorted(root.rglob(pattern))}
    # The digest of each file, not its bytes: no content can pass for a name.
    lines = [f"{name}\0{digest_of(names[name].read_bytes())}\n" for name in names if not name.startswith(left_out)]
    return digest_of("".join(lines))


def digest_of(content: str | bytes) -> str:
    """SHA-256 of a text or a file's content."""
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()


def keep(content: Mapping[str, object], digest: str, file: Path) -> None:
    """Write a result, whole or not at all, with the digest of what it depends on."""
    write_json({"digest": digest, **content}, file)


def kept(file: Path, digest: str) -> dict[str, Any] | None:
    """What `keep` wrote under this digest; None where the result is to be made (again)."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        return content if content.pop("digest") == digest else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
