"""A finished run used again, through the whole program."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from calls import PinnRun
from storeys import K, record, system, written

from pinn_cli import load
from pinn_cli.model.file import NAME, read_model
from pinn_cli.report.figures.parameters import over_time_figure

UNDRAWN = "figures=false"
FIRST = (*system(1.1 * K), "scheme=state_parameter", "scheme.unknown=[k_*]", "scheme.starts=given", UNDRAWN)


def files(folder: Path) -> dict[str, tuple[str, ...]]:
    return {
        name: written(each.record, folder / f"{name}.csv")
        for name, each in (("one", record(1)), ("two", record(2)), ("less", record(2, third=0.95)))
    }


@pytest.mark.slow
def test_records_one_after_the_other(pinn_run: PinnRun, tmp_path: Path) -> None:
    data = files(tmp_path)
    pinn_run(*FIRST, *data["one"], "hydra.run.dir=first").done()

    pinn_run("model=first", *data["two"], UNDRAWN, "hydra.run.dir=new").done()
    found, known = (pd.read_csv(f"{run}/parameters.csv").set_index("parameter") for run in ("new", "first"))
    for name in ("k_1", "k_3", "c_2"):
        assert found.loc[name, "prescribed"] == pytest.approx(known.loc[name, "estimate"], rel=1e-6)
    assert not Path("new/parameters_over_time.csv").exists()

    second = pinn_run("model=first", "scheme=update", *data["two"], UNDRAWN, "hydra.run.dir=second").done()
    assert "no change since the earlier records" in second.out
    third = pinn_run("model=second", "scheme=update", *data["less"], UNDRAWN, "hydra.run.dir=third").done()
    assert "changed: k_3 (connection 3) by -" in third.out
    table = pd.read_csv("third/parameters_over_time.csv")
    drawn = over_time_figure(table)
    titles = [axes.get_title() for axes in drawn.axes]
    assert titles[0].startswith("c_1 (")
    changed = drawn.axes[[title.startswith("k_3") for title in titles].index(True)]
    assert any(line.get_linestyle() == "--" for line in changed.get_lines())
    assert list(table["record"].unique()) == [1, 2, 3]
    assert list(table["run"].unique()) == ["first", "second", "third"]
    assert set(table.loc[table["changed"], "parameter"]) == {"k_3"}
    of_k_3 = table[table["parameter"] == "k_3"].set_index("record")
    assert of_k_3.loc[3, "change"] == pytest.approx(-0.05 * K[2], abs=4.0 * of_k_3.loc[3, "change_std"])
    assert of_k_3.loc[3, "chance"] < 1e-6
    assert of_k_3.loc[2, "std"] < of_k_3.loc[1, "std"]
    assert (
        of_k_3.loc[3, "lower_90"] < 0.95 * K[2] < of_k_3.loc[3, "upper_90"]
        or abs(of_k_3.loc[3, "estimate"] - 0.95 * K[2]) < 4.0 * of_k_3.loc[3, "std"]
    )
    of_k_1 = table[table["parameter"] == "k_1"].set_index("record")
    assert of_k_1.loc[3, "std"] < of_k_1.loc[2, "std"]  # what did not change goes on being learned
    assert load("third").plot.modes().axes  # of the model's structure, not of the one that system would be

    pinn_run(*system(), "system.ndof=2", "system.m=1", "system.c=1", "system.k=1", "model=first", *data["two"]).refused(
        "2 DOFs, not 3"
    )
    for scheme in ("state_parameter", "bayesian"):
        pinn_run("model=first", f"scheme={scheme}", *data["two"]).refused(f"null with scheme={scheme}")


def test_a_model_holds_no_truth(pinn_run: PinnRun) -> None:
    """Of a simulated record the truth is known to the run; none of its numbers is in the model."""
    pinn_run(
        "system.ndof=2", "model_error=perturbed", "simulation.samples=512", "simulation.duration=20", UNDRAWN,
        "noise.snr_db=20", "hydra.run.dir=first",
    ).done()  # fmt: skip
    true = pd.read_csv("first/parameters.csv").set_index("parameter")["true"]
    with np.load(f"first/{NAME}") as content:
        numbers = np.concatenate([content[name].astype(float).ravel() for name in content.files if name != "content"])
        words = json.loads(bytes(content["content"]).decode())
    assert not any("true" in str(key) for key in words)
    uncertain = true[[name for name in true.index if not name.startswith("m")]]
    assert not np.isin(uncertain.to_numpy(), numbers).any()
    model = read_model("first")
    assert [p.name for p in model.parameters] == list(uncertain.index)


def test_update_without_a_model_is_refused(pinn_run: PinnRun) -> None:
    pinn_run("scheme=update").refused("the directory of a finished run with scheme=update")
    pinn_run("model=nowhere").refused("no such directory")
    assert not Path("outputs").exists()


@pytest.mark.slow
def test_a_prediction_without_a_response(pinn_run: PinnRun, tmp_path: Path) -> None:
    pinn_run(*FIRST, *written(record(1).record, tmp_path / "one.csv"), "hydra.run.dir=first").done()
    new = record(4, duration=6.0)
    table = np.column_stack((new.record.time, new.truth.force[:, 2]))
    np.savetxt(tmp_path / "design.csv", table, delimiter=",", header="t,f", comments="")
    data = ("data=csv", f"data.path={tmp_path / 'design.csv'}", "data.time=t", "data.force={3: f}", UNDRAWN)
    done = pinn_run("model=first", "scheme=predict", "scheme.draws=50", *data, "hydra.run.dir=next").done()
    assert "peak drift of connection 3" in done.out
    with xr.open_dataset("next/response.nc") as response:
        error = np.abs(response["displacement"].values - new.truth.displacement)
        assert (error < 4.0 * response["displacement_std"].values + 1e-9).mean() > 0.95
        assert error.max() < 0.05 * np.abs(new.truth.displacement).max()
    assert len(pd.read_csv("next/peaks.csv")) == 15
    assert "verdict" not in json.loads(Path("next/run.json").read_text())
    assert not Path("next/model.npz").exists()
    assert load("next").plot.response().axes
    pinn_run("model=next", "scheme=predict", *data).refused("has no model.npz")
    pinn_run("model=first", *data).refused("at least one of them")
