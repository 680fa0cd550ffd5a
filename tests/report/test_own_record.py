"""What a run on a measured record leaves and prints: its sensors, and no numbers that nobody can know."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calls import MEASURED, PinnRun
from small_problems import measured, small_chain

SETTINGS = (
    *MEASURED, "system.m=10", "system.c=1", "system.k=15", "system.kappa=100",
    "data=csv", "data.path=rig.csv", "data.time=t", "data.force={1: f}",
    "data.acceleration={1: a1, 2: a2, 3: a3}", "figures=false",
)  # fmt: skip


@pytest.fixture
def rig(tmp_path: Path) -> None:
    record = measured(small_chain(), snr_db=40.0).record
    columns = {f"a{dof}": record.acceleration[:, dof - 1] for dof in (1, 2, 3)}
    pd.DataFrame({"t": record.time, "f": record.force[:, 0], **columns}).to_csv(tmp_path / "rig.csv", index=False)


@pytest.mark.usefixtures("rig")
def test_it_is_told_sensor_by_sensor_with_the_baseline_beside(pinn_run: PinnRun) -> None:
    outcome = pinn_run(*SETTINGS, "baseline=kalman_smoother")
    assert outcome.status == 0, outcome.err
    paragraphs = outcome.out.split("\n\n")
    assert "kalman_smoother (%)" in paragraphs[0].splitlines()[0]
    assert "fitness" not in outcome.out
    # Of the force there is no free run: the only cell without a number.
    assert sum(line.split().count("-") for line in outcome.out.splitlines()) == 1
    assert "\nseconds: pinn " in outcome.out
    table = pd.read_csv(outcome.directory / "residuals.csv")
    assert table["estimator"].tolist() == ["pinn"] * 4 + ["kalman_smoother"] * 4
    ours = table[table["estimator"] == "pinn"]
    assert ours["nmse_percent"].between(0.001, 0.1).all()
    assert ours["sigma"].notna().all()
    assert ours["free_run_nmse_percent"].notna().tolist() == [True, True, True, False]
    assert np.isfinite(table["whiteness"]).all()


@pytest.mark.usefixtures("rig")
def test_a_held_out_sensor_is_scored_by_itself(pinn_run: PinnRun) -> None:
    outcome = pinn_run(*SETTINGS, "data.holdout=[2]")
    assert outcome.status == 0, outcome.err
    (fitness,) = [part for part in outcome.out.split("\n\n") if "\nDOFs " in part]
    assert [line.split()[0] for line in fitness.splitlines()[3:]] == ["all", "unobserved", "dof_2", "*"]
    assert "displ." not in fitness
    table = pd.read_csv(outcome.directory / "fitness.csv")
    assert len(table) == 4 * (5 + 3)
    scores = table.set_index(["group", "quantity"])["fitness_percent"]
    assert scores["dof_2", "acceleration"] > 80
    assert pd.isna([scores["dof_2", "displacement"], scores["dof_1", "acceleration"]]).all()
