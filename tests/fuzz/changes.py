"""What is changed within a file of a run or a sweep, and files that are far more than they look."""

import csv
import json
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import yaml
from scipy.io import savemat


def set_(place: Path, change: tuple[str, Any]) -> None:
    """Set a value: of JSON at a key, of YAML at a dotted name, of a table in a whole column, of arrays by name."""
    name, value = change
    match place.suffix:
        case ".json":
            content = json.loads(place.read_text(encoding="utf-8"))
            place.write_text(json.dumps(content | {name: value}), encoding="utf-8")
        case ".yaml":
            content = node = yaml.safe_load(place.read_text(encoding="utf-8")) or {}
            *above, last = name.split(".")
            for key in above:
                node = node.get(key) if isinstance(node.get(key), dict) else node.setdefault(key, {})
            node[last] = value
            place.write_text(yaml.safe_dump(content), encoding="utf-8")
        case ".csv":
            rows = list(csv.DictReader(place.read_text(encoding="utf-8").splitlines()))
            with place.open("w", newline="", encoding="utf-8") as file:
                writer = csv.DictWriter(
                    file, [*(rows[0] if rows else ()), *(() if rows and name in rows[0] else (name,))]
                )
                writer.writeheader()
                writer.writerows(row | {name: value} for row in rows)
        case ".npz":
            with np.load(place) as kept:
                arrays = {key: kept[key] for key in kept.files}
            np.savez(place, **{**arrays, name: np.array(0.0 if value is None else value)})


def sql_(place: Path, statements: str) -> None:
    """Run statements on a database; those that it refuses change nothing."""
    with sqlite3.connect(place) as database:
        try:
            database.executescript(statements)
        except sqlite3.Error:
            database.rollback()
    database.close()


def hdf5_(place: Path, kind: str) -> None:
    """Change labelled histories; a file that takes no change stays as it is."""
    try:
        with h5py.File(place, "r+") as file:
            HISTORIES[kind](file)
    except (OSError, KeyError, ValueError):
        return


def _instead(name: str, make: Callable[[h5py.File], Any]) -> Callable[[h5py.File], None]:
    """Something else, where an array was."""

    def fill(file: h5py.File) -> None:
        del file[name]
        file[name] = make(file)

    return fill


def _huge(file: h5py.File) -> None:
    file.create_dataset("huge", (2**40,), "f8", chunks=(2**20,))


def _virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout((4,), "f8")
    layout[:] = h5py.VirtualSource("../rig.csv", "x", (4,))
    file.create_virtual_dataset("virtual", layout)


def _raw_elsewhere(file: h5py.File) -> None:
    file.create_dataset("raw", (4,), "f8", external=[("rig.csv", 0, 32)])


def _random(file: h5py.File) -> None:
    """Nothing is as it was beyond the signature and the first block; the same bytes at each call."""
    name = file.filename
    file.close()
    size = Path(name).stat().st_size - 96
    with open(name, "r+b") as raw:
        raw.seek(96)
        raw.write(np.random.default_rng(0).bytes(size))


def _escapes(file: h5py.File) -> None:
    file.attrs["case"] = "\x1b[2Jverdict: sound"
    file["displacement"].attrs["units"] = "\x1b]0;title\x07"
    file["\x1b[2J"] = file["time"]


def _many_groups(file: h5py.File) -> None:
    for number in range(1000):
        file[f"g{number}"] = file["/"]


def _one_text(file: h5py.File) -> None:
    """A long one among so many: as an array each is as long."""
    file["texts"] = np.array(["x" * 100_000, *["x"] * 30_000], dtype=object)


HISTORIES: dict[str, Callable[[h5py.File], None]] = {
    "circle": lambda file: file.create_group("rig").__setitem__("rig", file["/"]),
    "links": lambda file: [file.__setitem__(f"l{i}", h5py.SoftLink(f"/l{(i + 1) % 3}")) for i in range(3)],
    "elsewhere": _instead("displacement", lambda file: h5py.ExternalLink("other.nc", "/x")),
    "compound": _instead("velocity", lambda file: np.zeros((), [("a", "f8"), ("b", "S5")])),
    "references": _instead("velocity", lambda file: np.array([file.ref] * 5, dtype=h5py.ref_dtype)),
    "lists": _instead("velocity", lambda file: np.zeros((4, 4, 4, 4))),
    "no time": lambda file: file.__delitem__("time"),
    "time of another length": _instead("time", lambda file: np.arange(3.0)),
    "time is a text": _instead("time", lambda file: "x"),
    "packed": lambda file: file.create_dataset("zeros", (10**4, 10**5), "f8", chunks=(100, 10**4), compression="gzip"),
    "dates": lambda file: file["time"].attrs.update({"units": "days since 0000-99-99", "calendar": "x"}),
    "filled": lambda file: file["displacement"].attrs.update({"_FillValue": "x", "scale_factor": "y"}),
    "dimensions": lambda file: file["displacement"].attrs.__setitem__("DIMENSION_LIST", np.arange(3)),
    "huge": _huge, "virtual": _virtual, "raw": _raw_elsewhere, "random": _random, "escapes": _escapes,
    "groups": _many_groups, "one text": _one_text,
}  # fmt: skip


def bomb(place: Path, kind: str) -> None:
    """Write a file that is far more than it looks."""
    BOMBS[kind](place)


def _structure(place: Path, fill: Callable[[h5py.File], None]) -> None:
    """A MAT file of version 7.3, or any HDF5 file."""
    with h5py.File(place, "w", userblock_size=512) as file:
        file["t"] = np.arange(100) / 20.0
        file["a"] = np.sin(np.arange(100) / 3.0)
        file["f"] = np.cos(np.arange(100) / 3.0)
        fill(file)
    with place.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")


def _circle(file: h5py.File) -> None:
    group = file.create_group("rig")
    group["rig"] = group
    for number in range(12):
        group[f"other{number}"] = file["rig"]


def _references(file: h5py.File) -> None:
    every = [file.create_dataset(f"s/c{i}", (12,), h5py.ref_dtype) for i in range(12)]
    for each in every:
        each[:] = [other.ref for other in every]


def _many_references(file: h5py.File) -> None:
    file.create_dataset("s/c", (500_000_000,), h5py.ref_dtype, chunks=(1_000_000,), compression="gzip")


def _wide(file: h5py.File) -> None:
    kind = np.dtype([(f"c{i}", "f8") for i in range(600)])
    file.create_dataset("table", (50_000_000,), kind, chunks=(100,), compression="gzip")


def _zeros(file: h5py.File) -> None:
    file.create_dataset("acc", (100_000, 1_000_000), "f8", chunks=(1000, 1000), compression="gzip")


def _enumeration(file: h5py.File) -> None:
    file["e"] = np.zeros(10, h5py.enum_dtype({f"name{i}": i for i in range(3000)}, basetype="i4"))


def _names(file: h5py.File) -> None:
    for number in range(20_000):
        file.create_group(f"g{number}")


def _mat(place: Path) -> None:
    savemat(place, {"t": np.arange(100) / 20.0, "acc": np.zeros((4000, 30_000))}, do_compression=True)


def _nested_mat(place: Path) -> None:
    node: Any = np.zeros(3)
    for _ in range(200):
        node = {"a": node, "b": node} if isinstance(node, np.ndarray) else {"a": node}
    savemat(place, {"t": np.arange(100) / 20.0, "s": node})


BOMBS: dict[str, Callable[[Path], None]] = {
    **{fill.__name__.strip("_"): (lambda place, fill=fill: _structure(place, fill)) for fill in (
        _circle, _references, _many_references, _wide, _zeros, _enumeration, _names,
    )},
    "mat": _mat,
    "nested_mat": _nested_mat,
}  # fmt: skip
