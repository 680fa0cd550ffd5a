"""A folder with one record, as a user has it: ``python -m benchmarks.nearly_right.record backlash /tmp/rig``.

It holds `record.csv`, the experiment `experiment/machine.yaml` and `truth.json`, which nobody but a judge may read:

    pinn-run --config-dir /tmp/rig experiment=machine hydra.run.dir=/tmp/rig/run
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import pandas as pd
import yaml

from benchmarks.nearly_right.machines import KINDS, Measured, measured
from benchmarks.trust.case import defaults


def experiment(truth: Measured, path: Path) -> dict[str, object]:
    """Settings of the run: a chain whose m, c and k are unknown, the first half of the record."""
    n, model = truth.model.ndof, truth.model
    kinds = ("m", "c", "k") if model.speed is None else ("m", "c", "k", "F_c")
    guess = np.array([float(f"{value:.4g}") for value in truth.guess]).reshape(len(kinds), n)
    system: dict[str, object] = {"ndof": n} | {kind: row.tolist() for kind, row in zip(kinds, guess, strict=True)}
    if model.speed is not None:
        system["nonlinearity"] = {"speed": float(f"{model.speed:.3g}")}
    data: dict[str, object] = {"path": str(path), "time": "t", "force": {model.driven: "force"}}
    for quantity, dof in model.sensors:
        data.setdefault(quantity, {})[dof] = f"{quantity}_{dof}"  # type: ignore[index]
    return {
        "defaults": defaults(
            system="linear" if model.speed is None else "friction", data="csv", scheme="state_parameter"
        ),
        "case": "nearly_right",
        "system": system,
        "data": data | {"stop": float(f"{truth.time[truth.half - 1]:.9g}")},
        "scheme": {"unknown": [f"{kind}_*" for kind in kinds]},
    }


def write(folder: Path, kind: str, record: int, number: int | None = None) -> Measured:
    """Make a record and leave it in the folder."""
    truth = measured(kind, record, number)
    (folder / "experiment").mkdir(parents=True, exist_ok=True)
    path = folder.resolve() / "record.csv"
    columns = [f"{quantity}_{dof}" for quantity, dof in truth.model.sensors]
    table = pd.DataFrame(np.column_stack([truth.time, truth.force, truth.sensors]), columns=["t", "force", *columns])
    table.to_csv(path, index=False, float_format="%.9g")
    text = yaml.safe_dump(experiment(truth, path), sort_keys=False)
    (folder / "experiment" / "machine.yaml").write_text(f"# @package _global_\n{text}", encoding="utf-8")
    told = {
        "kind": kind, "record": record, "parameters": dict(zip(truth.model.names, truth.true.tolist(), strict=True)),
        "names_it": KINDS[kind].names,
    }  # fmt: skip
    (folder / "truth.json").write_text(json.dumps(told, indent=1), encoding="utf-8")
    return truth


def main() -> None:
    """Write one folder."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.nearly_right.record", description=__doc__)
    parser.add_argument("kind", choices=tuple(KINDS))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--record", type=int, default=0, help="seed of excitation, level, noise and first guess")
    parser.add_argument("--machine", type=int, help="another machine than the kind's: 0, 1, ...")
    given = parser.parse_args()
    write(given.folder, given.kind, given.record, given.machine)


if __name__ == "__main__":
    main()
