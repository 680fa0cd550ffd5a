"""Where a path that a user gave leads."""

from __future__ import annotations

from pathlib import Path


def located(path: str | Path, base: Path | None = None) -> Path:
    """The path with ``~`` spelled out, as a shell would; a relative one starts at ``base``, None: where we are.

    A ``~`` that names nobody's home is taken as it stands: there will be no such file, and that is said of it.
    """
    try:
        path = Path(path).expanduser()
    except RuntimeError:
        path = Path(path)
    return (base or Path()) / path
