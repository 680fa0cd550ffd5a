"""The exports that there are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pinn_cli.report.export.base import Export
from pinn_cli.report.export.csv import CsvExport
from pinn_cli.report.export.mat import MatExport
from pinn_cli.report.export.uff import UffExport
from pinn_cli.settings.errors import InputError

EXPORTS: dict[str, type[Export]] = {export.name: export for export in (CsvExport, MatExport, UffExport)}


def exports_of(names: Any) -> tuple[Export, ...]:
    """Those that ``report.export`` names, in its order, each once.

    Raises:
        InputError: It is no list of names that there are, or one needs a package that is not installed.
    """
    if not isinstance(names, Sequence) or isinstance(names, str) or not all(name in EXPORTS for name in names):
        raise InputError("report.export", names, f"a list of any of {', '.join(EXPORTS)}")
    exports = tuple(EXPORTS[name]() for name in dict.fromkeys(names))
    for export in exports:
        export.check()
    return exports
