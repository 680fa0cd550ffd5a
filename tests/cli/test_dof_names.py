"""Names of DOFs where settings ask for DOFs, and in what a run says of them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from calls import PinnRun
from omegaconf import OmegaConf

from pinn_cli.cli.dof_names import numbered
from pinn_cli.settings.errors import InputError
from pinn_cli.system.parameters import Labels

LABELS = Labels(("ground_floor", "mezzanine", "roof"), ("a", "b", "c"))
CONNECTIONS = (
    "storey_1: {between: [ground, ground_floor], law: linear, c: 4500, k: 1.5e6}",
    "storey_2: {between: [ground_floor, mezzanine], law: linear, c: 4200, k: 1.4e6}",
    "storey_3: {between: [mezzanine, roof], law: linear, c: 3600, k: 1.2e6}",
    "brace: {between: [ground, mezzanine], law: linear, c: 0, k: 4e5}",
)
FRAME = (
    "system=structure",
    "system.dofs=[ground_floor,mezzanine,roof]",
    "system.mass=2000",
    f"system.connections={{{', '.join(CONNECTIONS)}}}",
)


def test_names_and_numbers_are_the_same_dofs():
    config = OmegaConf.create(
        {
            "data": {
                "acceleration": {"roof": "a3", "1": "a1"},
                "force": {2: "f", "roof": None},
                "holdout": ["roof", 1],
            },
            "excitation": {"dofs": ["mezzanine"], "force": None},
            "scheme": {"unobserved": "every_2nd"},
        }
    )
    found = numbered(config, LABELS)
    assert found.data.acceleration == {3: "a3", 1: "a1"}
    assert found.data.force == {2: "f", 3: None}
    assert (found.data.holdout, found.excitation.dofs, found.scheme.unobserved) == ([3, 1], [2], "every_2nd")
    assert numbered(config, Labels()) is config


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"data": {"acceleration": {"rof": "a"}}}, "data.acceleration=rof: must be one of the DOFs ground_floor, mezz"),
        ({"data": {"acceleration": {"rof": "a"}}}, "did you mean roof?"),
        ({"data": {"force": {"roof": "a", 3: "b"}}}, "data.force=roof: must be there once only"),
        ({"data": {"holdout": [4]}}, "data.holdout=4: must be one of the DOFs"),
        ({"excitation": {"dofs": [0]}}, "or its number from 1 to 3"),
        ({"scheme": {"unobserved": [True]}}, "scheme.unobserved=True: must be one of the DOFs"),
        ({"excitation": {"force": {"dofs": ["attic"]}}}, "excitation.force.dofs=attic"),
        ({"validation": {"dofs": ["attic"]}}, "validation.dofs=attic"),
    ],
)  # fmt: skip
def test_a_dof_that_there_is_not_is_answered_with_the_names(given, message):
    with pytest.raises(InputError) as error:
        numbered(OmegaConf.create(given), LABELS)
    assert message in str(error.value)


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """A file of a force and two accelerometers, one of them dead."""
    time = np.arange(512) / 100.0
    force = 1e3 * np.sin(2 * np.pi * 2.0 * time + np.sin(7.0 * time))
    columns = {"t": time, "f": force, "top": 1e-3 * force + np.cos(9.0 * time), "dead": np.zeros(512)}
    pd.DataFrame(columns).to_csv(tmp_path / "rig.csv", index=False)
    return tmp_path / "rig.csv"


def test_messages_about_a_file_name_the_dof_as_the_user_does(pinn_run: PinnRun, rig: Path) -> None:
    sensors = ("data.force={roof: f}", "data.acceleration={roof: top, mezzanine: dead}")
    outcome = pinn_run(*FRAME, "data=csv", f"data.path={rig}", *sensors)
    assert (outcome.status, outcome.err.count("\n")) == (2, 1)
    assert "data.acceleration.mezzanine='dead'" in outcome.err


def test_files_and_sentences_of_a_run_have_the_names(pinn_run: PinnRun, tmp_path: Path) -> None:
    record = ("simulation.duration=8", "simulation.samples=512", "excitation.band=[1,10]", "excitation.rms=1e3")
    made = pinn_run(*FRAME, *record, "excitation.dofs=[roof]", "scheme.unobserved=[mezzanine]")
    assert made.status == 0, made.err
    with xr.open_dataset(made.directory / "response.nc") as dataset:
        assert dataset["dof_name"].values.tolist() == ["ground_floor", "mezzanine", "roof"]
        assert dataset["observed"].values.astype(bool).tolist() == [True, False, True]
        assert dataset["unforced"].values.astype(bool).tolist() == [True, True, False]
        accelerations = dataset["acceleration_true"].values
        columns = {"t": dataset["time"].values, "f": dataset["force_observed"].values[:, 2]}
    parameters = pd.read_csv(made.directory / "parameters.csv")["parameter"]
    assert {"k_storey_1", "k_brace", "c_storey_3"} <= set(parameters)
    assert {"dof_1", "dof_3"} <= set(pd.read_csv(made.directory / "fitness.csv")["group"])
    drawn = {figure.name for figure in (made.directory / "figures").iterdir()}
    assert {"structure.png", "structure.pdf", "response.png", "parameters.pdf", "residuals.png"} <= drawn
    # A sensor with the wrong sign is told by its DOF's name.
    accelerations = accelerations * [1, 1, -1] + np.random.default_rng(1).normal(0, 1e-3, accelerations.shape)
    columns |= {f"a{i + 1}": accelerations[:, i] for i in range(3)}
    pd.DataFrame(columns).to_csv(tmp_path / "signs.csv", index=False)
    outcome = pinn_run(
        *FRAME, "data=csv", f"data.path={tmp_path / 'signs.csv'}", "data.force={roof: f}", "figures=false",
        "data.acceleration={ground_floor: a1, mezzanine: a2, roof: a3}",
    )  # fmt: skip
    reasons = " ".join(json.loads((outcome.directory / "run.json").read_text())["reasons"])
    assert "acceleration of DOF roof" in reasons
