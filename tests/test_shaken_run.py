"""A frame in an earthquake, from the command to the files: sensors on the ground and on the roof."""

import re

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from calls import PinnRun

EARTHQUAKE = (
    "excitation=ground_motion", "excitation.highest=10", "excitation.rise=1", "excitation.strong=4",
    "excitation.decay=2", "simulation.duration=8", "simulation.samples=401", "system=linear", "system.ndof=2",
    "system.m=2000", "system.c=8e3", "system.k=2e6", "noise.snr_db=30", "scheme.unobserved=[1]",
)  # fmt: skip


def test_a_frame_in_an_earthquake(pinn_run: PinnRun) -> None:
    outcome = pinn_run(*EARTHQUAKE, "figures=false").done()
    drift = pd.read_csv(outcome.directory / "drift.csv")
    assert (drift["error_percent"] < 5.0).all()
    assert (drift["lower_90"] < drift["peak"]).all()
    assert (drift["peak"] < drift["upper_90"]).all()
    residuals = pd.read_csv(outcome.directory / "residuals.csv")
    assert residuals["quantity"].tolist() == ["acceleration", "ground_acceleration"]
    assert residuals["dof"].tolist() == [2, 0]
    with xr.open_dataset(outcome.directory / "response.nc") as response:
        assert response.attrs["frame"] == "absolute"
        ground = response["ground_acceleration"] - response["ground_acceleration_true"]
        measured = response["ground_acceleration_observed"] - response["ground_acceleration_true"]
        assert float((ground**2).mean()) < float((measured**2).mean())
        assert np.isfinite(response["ground_acceleration_std"]).all()
        left = response["drift"] - response["drift_true"]
        assert float(np.mean(np.abs(left) < 1.96 * response["drift_std"])) > 0.7
    verdict = outcome.record["verdict"]
    assert verdict == "sound", outcome.out


@pytest.mark.slow
def test_a_frame_of_which_the_roof_leaves_two_open(pinn_run: PinnRun) -> None:
    """Storeys of 4 and 1 MN/m move the roof as two of 2 MN/m do."""
    outcome = pinn_run(
        *EARTHQUAKE, "scheme=state_parameter", "scheme.unobserved=[1]", "scheme.unknown=[k_*,c_*]", "figures=false"
    ).done()
    found = outcome.parameters
    assert (found.loc[["k_1", "k_2"], "error_percent"] < 5.0).all()
    run = outcome.record
    assert run["verdict"] == "questionable"
    (reason,) = (x for x in run["reasons"] if x.startswith("another structure"))
    other = {name: float(x) for name, x in re.findall(r"(k_\d) = ([\d.e+]+)", reason)}
    assert other["k_1"] == pytest.approx(4e6, rel=0.1)
    assert other["k_2"] == pytest.approx(1e6, rel=0.1)
