"""One input of the command: arguments, and what lies in the folder where it is called."""

import base64
import hashlib
import io
import json
import math
import os
import pickle
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from calls import SMALL
from fuzz import changes

NEW = ("text", "bytes", "folder", "pipe", "gone", "link", "forged", "repeated", "sparse", "bomb")
FORMS = (*NEW, "cut", "flipped", "set", "sql", "hdf5")


@dataclass(frozen=True)
class Trial:
    """What is tried.

    Attributes:
        family: The kind of input: one of `fuzz.__main__.FAMILIES`.
        arguments: Of `pinn-run`; after ``load`` a directory, which `pinn_cli.load` opens.
        files: Path, from the folder on, to the form of what is put there and its content, see :func:`put`.
        start: What lies in the folder before: ``empty``, or one of `STARTS`.
        largest_file: Bytes that a file may have, as on a disk that is nearly full; None: no limit.
    """

    family: str
    arguments: tuple[str, ...]
    files: Mapping[str, tuple[str, Any]] = field(default_factory=dict)
    start: str = "empty"
    largest_file: int | None = None

    def prepare(self, folder: Path, marker: Path) -> None:
        """Put the files into their folder; code in them that is executed leaves ``marker``."""
        for name, (form, content) in self.files.items():
            place = folder
            for part in Path(name).parts:
                place = next(iter(sorted(place.glob(part))), place / part) if "*" in part else place / part
            put(place, form, content, marker)

    @property
    def name(self) -> str:
        """Of its file in the corpus."""
        return f"{self.family}-{hashlib.sha256(self.text().encode()).hexdigest()[:10]}"

    def text(self) -> str:
        """As JSON."""
        files = {name: [form, _plain(content)] for name, (form, content) in self.files.items()}
        content = {"family": self.family, "arguments": list(self.arguments), "start": self.start, "files": files}
        return json.dumps({**content, "largest_file": self.largest_file}, indent=1, sort_keys=True) + "\n"

    @classmethod
    def read(cls, file: Path) -> "Trial":
        """From a file of the corpus."""
        kept = json.loads(file.read_text(encoding="utf-8"))
        files = {
            name: (form, base64.b64decode(content) if form == "bytes" else content)
            for name, (form, content) in kept["files"].items()
        }
        return cls(kept["family"], tuple(kept["arguments"]), files, kept["start"], kept["largest_file"])


def put(place: Path, form: str, content: Any, marker: Path) -> None:
    """Put something at a place, or change what is there.

    Args:
        place: Where.
        form: ``text`` or ``bytes`` with that content; ``folder``, ``pipe``, ``gone``; ``link`` to the content; what is
            there ``cut`` to that part of its length, or ``flipped``, a bit at that part of it; ``forged``: a pickle
            that executes code, in a sealed checkpoint (``checkpoint``), in an archive as of torch (``archive``) or
            ``bare``; a text ``repeated`` so many times; ``sparse``, so many bytes of zeros; a ``bomb`` of
            `changes.BOMBS`; what is there ``set`` at a place to a value, or changed by ``sql`` or, ``hdf5``, as one of
            `changes.HISTORIES`. ``{marker}`` in a text is what executed code would make.
        content: See above.
        marker: The file that executed code would make.
    """
    place.parent.mkdir(parents=True, exist_ok=True)
    if form in NEW and os.path.lexists(place):
        if place.is_dir() and not place.is_symlink():
            for entry in sorted(place.rglob("*"), reverse=True):
                entry.rmdir() if entry.is_dir() and not entry.is_symlink() else entry.unlink()
            place.rmdir()
        else:
            place.unlink()
    match form:
        case "text":
            place.write_text(content.replace("{marker}", str(marker)), encoding="utf-8")
        case "bytes":
            place.write_bytes(content)
        case "folder":
            place.mkdir()
        case "pipe":
            os.mkfifo(place)
        case "link":
            place.symlink_to(content)
        case "forged":
            place.write_bytes(_forged(content, marker))
        case "repeated":
            place.write_text(content[0] * content[1], encoding="utf-8")
        case "sparse":
            with place.open("wb") as file:
                file.truncate(content)
        case "bomb":
            changes.bomb(place, content)
        case "set" | "sql" | "hdf5" if place.is_file():
            getattr(changes, f"{form}_")(place, content)
        case "cut" | "flipped" if place.is_file():
            place.write_bytes(_damaged(place.read_bytes(), form, content))
        case "gone" | "cut" | "flipped" | "set" | "sql" | "hdf5":
            pass
        case _:
            raise ValueError(f"{form} is none of {FORMS}")


def _damaged(data: bytes, form: str, part: float) -> bytes:
    index = min(int(part * len(data)), max(len(data) - 1, 0))
    if form == "cut" or not data:
        return data[:index]
    return data[:index] + bytes([data[index] ^ 0x10]) + data[index + 1 :]


class _Executes:
    """A pickle of it makes a file when it is read."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.marker),)


def _forged(kind: str, marker: Path) -> bytes:
    content = pickle.dumps({"format": 1, "identity": _Executes(marker)}, protocol=2)
    if kind == "bare":
        return content
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("archive/data.pkl", content)
        archive.writestr("archive/byteorder", "little")
        archive.writestr("archive/version", "3\n")
    body = buffer.getvalue()
    if kind == "archive":
        return body
    seal = hashlib.sha256(body[:-2]).hexdigest().encode()
    return body[:-2] + len(seal).to_bytes(2, "little") + seal


def _plain(content: Any) -> Any:
    return base64.b64encode(content).decode() if isinstance(content, bytes) else content


MEASURED = (
    "data=csv", "data.path=rig.csv", "data.time=t", "data.force={1: f}", "data.acceleration={1: a}", "system=linear",
    "system.ndof=1", "system.m=1", "system.c=0.4", "system.k=40", "figures=false", "threads=1",
)  # fmt: skip
ROWS = 160
QUICK = (*SMALL, "figures=false")
STEPS = (*QUICK, "network=mlp", "training=adam", "network.depth=2", "network.width=8", "training.iterations=3")
STEPPED = (*STEPS, "training.collocation_points=48", "training.checkpoint_every_s=1e-6")
FINISHED = (*QUICK, "hydra.run.dir=run")
STOPPED = (*STEPPED, "hydra.run.dir=run")
SWEPT = (*QUICK, "--multirun", "seed=0,1", "hydra.sweep.dir=sweep")
SEARCHED = (
    *QUICK, "--multirun", "hydra/sweeper=search", "validation=heldout", "scheme.unobserved_fraction=0.3",
    "network.degree=3,4,5", "hydra.sweeper.n_trials=3", "hydra.sweep.dir=sweep",
)  # fmt: skip
WINDOWED = (
    *MEASURED, "scheme=state_parameter", "scheme.unknown=[k_1]", "data.window=4", "data.overlap=1", "hydra.run.dir=run",
)  # fmt: skip
STARTS = {"finished": FINISHED, "stopped": STOPPED, "swept": SWEPT, "searched": SEARCHED, "windowed": WINDOWED}
# YAML each of whose lines is eight of the one before it.
UNFOLDING = "a: &a [x, x, x, x, x, x, x, x]\n" + "".join(
    f"{n}: &{n} [{', '.join(['*' + o] * 8)}]\n" for o, n in zip("abcdefghij", "bcdefghijk", strict=True)
)
# Of a run that was killed: what it would have written next.
UNWRITTEN = {"stopped": ("run.json",), "windowed": ("run.json", "windows/0002/window.json")}


def rig() -> list[list[str]]:
    """A mass on a spring and a damper under a sum of sines, as cells; the header first."""
    step, rows, state = 0.05, [["t", "f", "a"]], [0.0, 0.0]
    for index in range(ROWS):
        force = sum(math.sin(0.9 * n * step * index + n) for n in range(1, 9))
        acceleration = force - 0.4 * state[1] - 40.0 * state[0]
        rows.append([f"{step * index:.2f}", f"{force:.6f}", f"{acceleration:.6f}"])
        for _ in range(50):
            state[1] += step / 50 * (force - 0.4 * state[1] - 40.0 * state[0])
            state[0] += step / 50 * state[1]
    return rows


class Starts:
    """Folders to copy, made when they are first asked for.

    Args:
        folder: Where they are kept.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def lay(self, start: str, place: Path) -> None:
        """Put a start into a new folder."""
        if start == "empty":
            place.mkdir()
            return
        if not (self.folder / start).is_dir():
            self._make(start)
        shutil.copytree(self.folder / start, place, symlinks=True)

    def _make(self, start: str) -> None:
        made = self.folder / f".{start}"
        made.mkdir(parents=True)
        (made / "rig.csv").write_text("\n".join(",".join(row) for row in rig()), encoding="utf-8")
        command = [sys.executable, "-m", "pinn_cli.main", *STARTS[start]]
        subprocess.run(command, cwd=made, check=True, capture_output=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
        for name in UNWRITTEN.get(start, ()):
            (made / "run" / name).unlink()
        made.rename(self.folder / start)
