"""A case of the referee: records and settings as a user has them, and a truth that only the score reads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import yaml

HERE = "{folder}"  # in settings: the folder of the case's files
BEFORE = "{before}"  # in settings: the directory of the run before, of a case with two
Settings = Mapping[str, object]
Arrays = dict[str, np.ndarray]


def defaults(**groups: str) -> list[object]:
    """What an experiment begins with that chooses these options of groups."""
    return [*({f"override /{group}": option} for group, option in groups.items()), "_self_"]


# Of a person's own structure whose parameters are unknown.
UNKNOWN_STRUCTURE = defaults(system="structure", data="csv", scheme="state_parameter")


def record_data(name: str = "record.csv", **columns: object) -> dict[str, object]:
    """`data:` of an experiment: a file of the case, and its columns by quantity."""
    return {"path": f"{HERE}/{name}", "time": "t", **columns}


@dataclass(frozen=True)
class Truth:
    """What the estimate is compared with.

    Attributes:
        parameters: Name, as in `parameters.csv`, and true value of everything that is estimated and compared.
        displacement, velocity, acceleration: Relative to the ground, (time, n), at the first record's samples and in
            the order of the structure's DOFs; an empty array (0, n) where the response is not compared.
        sensed: DOFs, from 0, with a response sensor of any kind. Bands are counted at the others, if there are any.
        names_it: Regular expression; one of the run's reasons matches it if the fault is named. Empty without a fault.
    """

    parameters: dict[str, float]
    displacement: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    sensed: tuple[int, ...]
    names_it: str = ""


@dataclass(frozen=True)
class Case:
    """One structure and its records.

    Attributes:
        family: Name of the family that drew it.
        seed: Of the draw: family, seed and fault make the same case again.
        records: File name and table (a first column `t`, then one for each channel) of each record.
        settings: The experiment, as YAML has it; `HERE` in a text stands for the folder of the records.
        truth: For the score.
        about: A line for people.
        fault: What was spoilt; empty for a record and a model that are right.
        matrices: File name (.npz) and arrays of files beside the records.
        before: The experiment of a run that must come first, or None. `BEFORE` in `settings` is its directory.
        peer: What other estimators are told (`benchmarks.trust.peers`), or None where none can do the task.
    """

    family: str
    seed: int
    records: dict[str, pd.DataFrame]
    settings: Settings
    truth: Truth
    about: str = ""
    fault: str = ""
    matrices: dict[str, Arrays] = field(default_factory=dict)
    before: Settings | None = None
    peer: object | None = None

    @property
    def name(self) -> str:
        """Of its files and its rows."""
        return f"{self.family}_{self.seed}" + (f"_{self.fault}" if self.fault else "")

    def write(self, folder: Path) -> None:
        """Leave `folder/experiment/NAME.yaml` (and `NAME_before.yaml`) and the files in `folder/NAME/`."""
        own = (folder / self.name).resolve()
        own.mkdir(parents=True, exist_ok=True)
        for name, table in self.records.items():
            table.to_csv(own / name, index=False, float_format="%.12g")
        for name, arrays in self.matrices.items():
            np.savez(own / name, **arrays)  # type: ignore[arg-type]
        self._experiment(folder, self.name, self.settings)
        if self.before is not None:
            self._experiment(folder, f"{self.name}_before", self.before)

    def _experiment(self, folder: Path, name: str, settings: Settings) -> None:
        path = folder / "experiment" / f"{name}.yaml"
        path.parent.mkdir(parents=True, exist_ok=True)
        text = yaml.safe_dump({"case": name, **plain(settings)}, sort_keys=False, width=200)
        text = text.replace(HERE, str((folder / self.name).resolve()))
        text = text.replace(BEFORE, str((folder / "before" / self.name).resolve()))
        path.write_text(f"# @package _global_\n{text}", encoding="utf-8")


def plain(value: object) -> dict[str, object]:
    """Settings with numpy's numbers and arrays as Python's, for YAML."""

    def of(x: object) -> object:
        if isinstance(x, dict):
            return {of(k): of(v) for k, v in x.items()}
        if isinstance(x, list | tuple):
            return [of(v) for v in x]
        if isinstance(x, np.ndarray):
            return of(x.tolist())
        if isinstance(x, np.generic):
            return of(x.item())
        return float(f"{x:.12g}") if isinstance(x, float) else x

    found = of(value)
    assert isinstance(found, dict)
    return found
