"""MAT files of MATLAB and Octave: version 4 by SciPy, 5 to 7 here, 7.3, which is HDF5, by h5py."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pinn_cli.record.files.arrays import Variable, table_of
from pinn_cli.record.files.base import FileFormat
from pinn_cli.record.files.hdf5_tree import HDF5, opened, variables_of_matlab
from pinn_cli.record.files.mat5 import HEADER, names_of, variables_of
from pinn_cli.record.files.on_disk import beginning, damaged, other_format, read_bytes
from pinn_cli.record.files.table import Table
from pinn_cli.settings.errors import InputError

_EXPECTED = "a MAT file"
# Version and byte order at the end of the header, where HDF5 follows.
_VERSION_7_3 = (b"\x00\x02IM", b"\x02\x00MI")


class MatFormat(FileFormat):
    """Vectors and channels of matrices, by name: ``acc``, ``acc.2``; fields of structures ``rig.acc``.

    Element i of an array of structures is ``rig.2.acc``. Cells, objects, function handles and text are no numbers.
    """

    name = "mat"
    suffixes = (".mat",)

    def read(self, path: Path, wanted: Mapping[str, str] | None = None) -> Table:
        """See :class:`FileFormat`."""
        content = beginning(path)
        if content.startswith(HDF5) or content[124:128] in _VERSION_7_3:
            with opened(path, _EXPECTED) as file:
                return table_of(path, variables_of_matlab(file), wanted)
        if content.startswith(b"MATLAB") and len(content) < HEADER:
            raise damaged(path, _EXPECTED, ValueError("it ends within its header"))
        if content[126:128] in (b"IM", b"MI"):
            return table_of(path, _of_version_5(path, wanted), wanted)
        if not _is_version_4(content):
            raise other_format(path, content, _EXPECTED)
        return table_of(path, _of_version_4(path), wanted)


def _of_version_5(path: Path, wanted: Mapping[str, str] | None) -> dict[str, Variable]:
    content = read_bytes(path)
    try:
        roots = None if wanted is None else {name.partition(".")[0] for name in wanted.values()}
        if roots is not None and not roots <= set(names_of(content)):
            roots = None  # an error will list all columns
        return variables_of(path, content, roots)
    except InputError:
        raise
    except (ValueError, StopIteration, RuntimeError, OverflowError) as error:
        raise damaged(path, _EXPECTED, error) from None


def _is_version_4(content: bytes) -> bool:
    """Whether it begins with the type of a variable, MOPT: M is the byte order, P the precision, T the kind."""
    types = {int.from_bytes(content[:4], order) for order in ("little", "big")} if len(content) >= 20 else set()
    return any(m <= 4000 and m // 1000 in (0, 1) and m // 100 % 10 == 0 and m % 10 <= 2 for m in types)


def _of_version_4(path: Path) -> dict[str, Variable]:
    from scipy.io import loadmat

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of duplicate variables
            loaded = loadmat(str(path), appendmat=False)
    except Exception as error:  # SciPy raises a dozen kinds of a file that is cut off
        raise damaged(path, _EXPECTED, error) from None
    return {name: Variable.of(value) for name, value in loaded.items() if isinstance(value, np.ndarray)}
