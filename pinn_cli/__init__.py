"""Response, parameters and their uncertainty of vibrating structures, by physics-informed neural networks.

`run` does what the command `pinn-run` does, `load` opens what it left behind. `inspect` and `modes` look at a record,
`population` at the runs of similar structures.
"""

from __future__ import annotations

import time
from importlib import import_module
from typing import TYPE_CHECKING

# When the process reached this package, by `time.perf_counter`: Python has run for some 0.05 s by then.
LOADED = time.perf_counter()

if TYPE_CHECKING:
    from pinn_cli.api.results import Result, SweepResult, load
    from pinn_cli.api.run import inspect, modes, population, run
    from pinn_cli.api.structure import Record, Structure
    from pinn_cli.inspection.mode_report import ModesReport
    from pinn_cli.inspection.report import InspectionReport
    from pinn_cli.runs.writing import WriteError
    from pinn_cli.settings.errors import DivergenceError, InputError, NotSoundError
    from pinn_cli.sweep.population import PopulationReport

__all__ = [
    "DivergenceError", "InputError", "InspectionReport", "ModesReport", "NotSoundError", "PopulationReport", "Record",
    "Result", "Structure", "SweepResult", "WriteError", "inspect", "load", "modes", "population", "run",
]  # fmt: skip

# Imported when they are asked for (PEP 562): the command and its every worker import this package.
_WHERE = {
    "InspectionReport": "inspection.report",
    "ModesReport": "inspection.mode_report",
    "PopulationReport": "sweep.population",
    "Record": "api.structure",
    "Structure": "api.structure",
    "WriteError": "runs.writing",
    **dict.fromkeys(("inspect", "modes", "population", "run"), "api.run"),
    **dict.fromkeys(("load", "Result", "SweepResult"), "api.results"),
    **dict.fromkeys(("DivergenceError", "InputError", "NotSoundError"), "settings.errors"),
}


def __getattr__(name: str) -> object:
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = globals()[name] = getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
