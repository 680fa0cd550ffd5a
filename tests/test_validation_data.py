"""A whole run with ``data.validation``: its files and its table, and an estimate that knows nothing of the data."""

import numpy as np
import pandas as pd
from calls import PinnRun
from small_problems import measured, small_chain

OWN = ("parameters.csv", "fitness.csv", "residuals.csv", "modes.csv", "free_run.csv")
RIG = (
    "system=linear", "system.ndof=3", "system.m=10", "system.c=1", "data=csv", "data.path=rig.csv", "data.time=t",
    "data.force={1: f}", "data.acceleration={1: a1, 3: a3}", "scheme=state_parameter", "scheme.unknown=[k_*]",
    "scheme.starts=1", "threads=1", "figures=false",
)  # fmt: skip


def test_what_the_estimator_does_not_see(pinn_run: PinnRun) -> None:
    structure = small_chain("linear")
    record = measured(structure, snr_db=40.0, duration=20.0, samples=401).record
    columns = {"t": record.time, "f": record.force[:, 0], **{f"a{i}": record.acceleration[:, i - 1] for i in (1, 2, 3)}}
    table = pd.DataFrame(columns)
    table.to_csv("rig.csv", index=False)
    outcome = pinn_run(*RIG, "data.validation={start: 15}").done()
    found = pd.read_csv(outcome.directory / "validation.csv")
    assert found["dof"].tolist() == [1, 3]
    assert (found["nmse_percent"] < 1.0).all()
    assert found["inside_95_percent"].between(85.0, 100.0).all()
    assert "validation data" in outcome.out
    ruined = table.copy()
    ruined.loc[ruined["t"] >= 15.0, ["a1", "a3"]] = np.random.default_rng(0).standard_normal((101, 2))
    ruined.to_csv("rig.csv", index=False)
    again = pinn_run(*RIG, "data.validation={start: 15}", "figures=true")
    for name in OWN:
        assert (again.directory / name).read_bytes() == (outcome.directory / name).read_bytes(), name
    missed = pd.read_csv(again.directory / "validation.csv")["nmse_percent"]
    assert (missed > 50.0).all()
    _, page = (again.directory / "report.html").read_text(encoding="utf-8").split("Validation on other data")
    assert all(f"<td>{value:.3g}</td>" in page for value in missed)


def test_a_segment_that_was_seen_is_refused(pinn_run: PinnRun) -> None:
    table = pd.DataFrame({"t": 0.1 * np.arange(200), "f": 1.0, "a1": 0.0, "a3": 0.0})
    table.to_csv("rig.csv", index=False)
    pinn_run(*RIG, "data.validation={start: 5, stop: 8}", "data.stop=10").refused("outside of what the estimator sees")
