"""Labelled arrays of a directory that somebody else may have made: ``response.nc`` and ``posterior.nc``.

Their library reads them in a process of its own, see :mod:`pinn_cli.runs.apart`; numbers, texts and their labels come
here. What they mean, such as a number that says that there is none, is seen here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pinn_cli.runs.apart import Answer, UnreadableError, read_apart
from pinn_cli.runs.reading import NUMBER, WRITER, DamagedError, check_layout, check_regular, printable

if TYPE_CHECKING:
    import h5py
    import xarray as xr

# Of their layout; the first had no number.
HISTORIES = 1
# Bytes in memory for each of the file: ours are stored as they are.
_UNFOLDS = 4
# Groups of a file, beside the one that has them.
_MOST_GROUPS = 100


class Labelled(NamedTuple):
    """An array as it is stored: names of its dimensions, its content, and what is said of it."""

    dims: tuple[str, ...]
    values: np.ndarray
    attributes: dict[str, Any]

    @property
    def sizes(self) -> dict[str, int]:
        """Lengths of its dimensions by name."""
        return dict(zip(self.dims, self.values.shape, strict=True))


@dataclass(frozen=True)
class Group:
    """Labelled arrays by name, and what is said of all of them."""

    arrays: dict[str, Labelled]
    attributes: dict[str, Any]

    def decoded(self) -> xr.Dataset:
        """As everybody else reads it; raises what xarray does where it does not fit together."""
        import xarray as xr

        stored = xr.Dataset({name: tuple(array) for name, array in self.arrays.items()}, attrs=self.attributes)
        return xr.decode_cf(stored, decode_times=False)


def read_histories(file: Path, group: str = "/") -> xr.Dataset:
    """Labelled arrays as this program writes them, or a group of them.

    Raises:
        DamagedError: They cannot be read, or unfold to more than the file's size.
    """
    return _decoded(file, [group])[group]


def read_tree(file: Path) -> xr.DataTree:
    """All groups of a file of labelled arrays; damage is told as by :func:`read_histories`."""
    import xarray as xr

    return xr.DataTree.from_dict(_decoded(file, None))


def _decoded(file: Path, names: Sequence[str] | None) -> dict[str, xr.Dataset]:
    (groups,) = read_groups([file], names)
    try:
        return {name: group.decoded() for name, group in groups.items()}
    except Exception as error:  # labels that do not fit together: xarray and pandas raise dozens of kinds
        raise DamagedError(file, str(error) or type(error).__name__) from None


def read_groups(files: Sequence[Path], names: Sequence[str] | None = ("/",)) -> Iterator[dict[str, Group]]:
    """Groups of files by name, file after file, as they are stored; one other process reads all files.

    Of the names of groups "/" is what is in none; None: all groups.

    Raises:
        DamagedError: The next file cannot be read, or unfolds to more than its size.
        InputError: A later release wrote it.
    """
    largest = max((file.stat().st_size for file in files if file.is_file()), default=0)
    question = [[str(file) for file in files], names if names is None else list(names)]
    with closing(read_apart(stored, question, files, 2 * _UNFOLDS * largest)) as answers:
        for file in files:
            try:
                layout, arrays = next(answers)
            except UnreadableError as error:
                raise DamagedError(file, str(error)) from None
            following, groups = iter(arrays), {}
            for group, (of_group, attributes) in layout.items():
                labelled = {
                    name: Labelled(tuple(dims), next(following), _attributes(texts, following))
                    for name, (dims, texts) in of_group.items()
                }
                groups[group] = Group(labelled, _attributes(attributes, following))
            yield groups


def _attributes(texts: Mapping[str, Any], following: Iterator[np.ndarray]) -> dict[str, Any]:
    return {name: next(following)[()] if text is None else text for name, text in texts.items()}


def stored(files: Sequence[str], names: Sequence[str] | None) -> Iterator[Answer]:
    """What the other process answers of each file: the layout of its groups, and their arrays in its order.

    Raises:
        OSError, ValueError: It is none of ours.
    """
    import h5netcdf
    import h5py

    for file in map(Path, files):
        check_regular(file, float("inf"))
        with h5py.File(file, "r") as opened:
            number = np.asarray(opened.attrs.get(NUMBER, 1)).item()
            check_layout({NUMBER: number, WRITER: opened.attrs.get(WRITER)}, HISTORIES, file)
            _arrays(opened)
            chosen = names or ["/", *(name for name, node in opened.items() if isinstance(node, h5py.Group))]
            if len(chosen) > _MOST_GROUPS:
                raise ValueError(f"it has more than {_MOST_GROUPS} groups")
            nodes = {name: opened[name] for name in chosen}
            _check([node for group in nodes.values() for node in _arrays(group)], file)
            labelled = h5netcdf.File(opened)
            arrays: list[np.ndarray] = []
            of_labels = {name: labelled if name == "/" else labelled[name] for name in chosen}
            yield {name: _layout(of_labels[name], node, arrays) for name, node in nodes.items()}, arrays


def _arrays(group: h5py.Group) -> list[h5py.Dataset]:
    """Arrays of a group, which must lie in its file."""
    import h5py

    if not all(isinstance(group.get(name, getlink=True), h5py.HardLink) for name in group):
        raise ValueError("it links to another place")
    return [node for node in group.values() if isinstance(node, h5py.Dataset)]


def _check(nodes: Sequence[h5py.Dataset], file: Path) -> None:
    if any(node.external or node.is_virtual for node in nodes):
        raise ValueError("it holds data of another file")
    if sum(node.nbytes for node in nodes) > _UNFOLDS * file.stat().st_size:
        raise ValueError("it unfolds to more than was written")


def _layout(group: Any, node: h5py.Group, arrays: list[np.ndarray]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Names, dimensions and attributes of the arrays of a group, and its own; what is no text goes to the arrays."""
    layout = {}
    for name, variable in group.variables.items():
        values = np.asarray(node[name][()])  # not by the variable, which asks for the sizes of all dimensions anew
        arrays.append(_texts(values) if values.dtype.kind == "O" else values)
        dims = [printable(dim) for dim in variable.dimensions]
        layout[printable(name)] = dims, _attr_texts(variable.attrs, arrays)
    return layout, _attr_texts(group.attrs, arrays)


def _texts(values: np.ndarray) -> np.ndarray:
    if not all(isinstance(text, str | bytes) for text in values.flat):
        raise ValueError("it holds other things than numbers and texts")
    return np.array([_text(text) for text in values.flat], dtype=str).reshape(values.shape)


def _text(text: str | bytes) -> str:
    return printable(text if isinstance(text, str) else text.decode("utf-8", "replace"))


def _attr_texts(attributes: Mapping[str, Any], arrays: list[np.ndarray]) -> dict[str, Any]:
    """Texts by name, and None for what goes to the arrays."""
    texts: dict[str, Any] = {}
    for name, value in attributes.items():
        if isinstance(value, str | bytes):
            texts[printable(name)] = _text(value)
        elif isinstance(value, list) and all(isinstance(text, str | bytes) for text in value):
            texts[printable(name)] = [_text(text) for text in value]
        else:
            texts[printable(name)] = None
            arrays.append(np.asarray(value))
    return texts
