"""A spring that softens, with a law that can only stiffen, through the whole program."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calls import PinnRun
from independent_records import storey_record

SYSTEM = ("system=duffing", "system.ndof=1", "system.m=12", "system.c=10", "system.k=4e3")


@pytest.mark.slow
@pytest.mark.parametrize(("softens", "seed"), [(0.0, 1), (0.0, 2), (0.01, 1), (0.01, 2)])
def test_a_bound_that_the_spring_contradicts_is_told_and_the_model_is_that_of_the_table(
    pinn_run: PinnRun, tmp_path: Path, softens: float, seed: int
) -> None:
    """With a linear spring the unknown cubic one is about zero, and the run is sound."""
    size = storey_record((0.3, 12.0), 2000, 100.0, 3.0, 40.0, seed, mass=12.0).truth.displacement.std()
    made = storey_record((0.3, 12.0), 2000, 100.0, 3.0, 40.0, seed, mass=12.0, kappa=-softens / size**2).record
    columns = {"t": made.time, "f": made.force[:, 0], "a": made.acceleration[:, 0]}
    pd.DataFrame(columns).to_csv(tmp_path / "rig.csv", index=False)
    data = (
        "data=csv", f"data.path={tmp_path}/rig.csv", "data.time=t", "data.force={1: f}", "data.acceleration={1: a}",
        "figures=false", "threads=1",
    )  # fmt: skip
    unknown = "scheme.unknown=[k_1,c_1,kappa_1]"
    pinn_run(*SYSTEM, *data, "scheme=state_parameter", unknown, "hydra.run.dir=first").done()
    run = json.loads(Path("first/run.json").read_text())
    assert run["verdict"] == ("questionable" if softens else "sound")
    assert any("kappa_1 is held at its bound, 0" in reason for reason in run["reasons"]) == bool(softens)
    pinn_run("model=first", *data, "hydra.run.dir=again").done()
    table, used = (pd.read_csv(f"{name}/parameters.csv").set_index("parameter") for name in ("first", "again"))
    assert np.all(np.abs(used["prescribed"] - table["estimate"]) < 0.02 * table["std"])
