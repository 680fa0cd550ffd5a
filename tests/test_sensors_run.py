"""Sensors in doubt through the whole program: names of DOFs, units, a gain and a delay that nobody knows, gaps."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from calls import PinnRun
from independent_records import frame_record

GAIN, OFFSET, DELAY = 1.2, 0.5, 2  # of the roof's accelerometer: m/s^2, samples
GRAVITY = 9.80665


@pytest.fixture
def settings(tmp_path: Path) -> tuple[str, ...]:
    """The linear frame for 8 s: half of one channel missing, another in g with a gain, an offset and a delay."""
    made = frame_record(rate=60.0, duration=8.0, band=(0.5, 10.0), cubic=False, sensors=(("acceleration", (1, 2, 3)),))
    record, s = made.record, made.structure
    a1, a2, a3 = record.acceleration.T.copy()
    a1[np.random.default_rng(0).random(len(a1)) < 0.5] = np.nan
    late = GAIN * np.roll(a3, DELAY) + OFFSET
    late[:DELAY] = np.nan
    columns = {"t": record.time, "f": record.force[:, 2] / 1e3, "a1": a1, "roof": late / GRAVITY, "x2 acc": a2}
    pd.DataFrame(columns).to_csv(tmp_path / "frame.csv", index=False)
    ends = ("ground", "x1", "x2", "x3")
    storeys = ", ".join(
        f"storey_{i + 1}: {{between: [{ends[i]}, {ends[i + 1]}], law: linear, c: {s.c[i]}, k: null}}" for i in range(3)
    )
    channels = (
        "{a1: {sensor: acceleration, dof: x1}, two: {sensor: acceleration, dof: 2, column: x2 acc},"
        " roof: {sensor: acceleration, dof: x3, unit: g, gain: unknown, offset: unknown, delay: unknown},"
        " f: {sensor: force, dof: x3, unit: kN}}"
    )
    return (
        "system=structure", "system.dofs=[x1,x2,x3]", f"system.mass={{x1: {s.m[0]}, x2: {s.m[1]}, x3: {s.m[2]}}}",
        f"system.connections={{{storeys}}}", "data=csv", f"data.path={tmp_path / 'frame.csv'}",
        f"data.channels={channels}", "figures=false", "threads=1",
    )  # fmt: skip


def test_gains_delays_and_springs_in_one_run(pinn_run: PinnRun, settings: tuple[str, ...]) -> None:
    done = pinn_run(*settings, "scheme=state_parameter", "scheme.unknown=[k_*]").done()
    made = frame_record(rate=60.0, duration=8.0, band=(0.5, 10.0), cubic=False, sensors=(("acceleration", (1, 2, 3)),))
    table = done.parameters
    true = {"gain_roof": GAIN, "offset_roof": OFFSET, "delay_roof": DELAY / 60.0}
    true |= {f"k_storey_{i + 1}": k for i, k in enumerate(made.structure.k)}
    for name, value in true.items():
        assert abs(table.loc[name, "estimate"] - value) < 4.0 * table.loc[name, "std"], name
    assert table.loc["gain_roof", "std"] < 0.02
    assert table.loc["delay_roof", "std"] < 0.1 / 60.0
    for i, k in enumerate(made.structure.k):
        assert table.loc[f"k_storey_{i + 1}", "estimate"] == pytest.approx(k, rel=0.02)
    assert done.record["verdict"] == "sound"
    with xr.open_dataset(done.directory / "response.nc") as response:
        shown = response["acceleration_observed"].values
        assert 0.4 < np.isnan(shown[:, 0]).mean() < 0.6
        left = shown[:, 2] - response["acceleration"].values[:, 2]
        assert np.nanstd(left) < 0.05 * np.nanstd(shown[:, 2])


@pytest.mark.slow
def test_a_held_out_channel_with_gaps_scores_where_it_has_samples(pinn_run: PinnRun, settings: tuple[str, ...]) -> None:
    known = [s.replace("k: null", f"k: {k}") for s, k in zip(settings, ["1.4e6"] * len(settings), strict=True)]
    known = [s.replace("gain: unknown, offset: unknown, delay: unknown", "gain: 1.2, offset: 0.5") for s in known]
    done = pinn_run(*known, "data.holdout=[x1]").done()
    table = pd.read_csv(done.directory / "fitness.csv").set_index(["group", "quantity"])
    score = table.loc[("dof_1", "acceleration"), "fitness_percent"]
    assert np.isfinite(score)


def test_a_posterior_given_the_motion_tells_nothing_of_sensors(pinn_run: PinnRun, settings: tuple[str, ...]) -> None:
    outcome = pinn_run(*settings, "scheme=bayesian", "posterior=conditional")
    assert outcome.status == 2
    assert "posterior=conditional: must be marginal or laplace where samples are missing" in outcome.err


@pytest.mark.slow
def test_the_posterior_of_sensors_and_springs_holds_the_truth(pinn_run: PinnRun, settings: tuple[str, ...]) -> None:
    done = pinn_run(
        *settings, "scheme=bayesian", "scheme.unknown=[k_*]", "posterior.draws=1000", "posterior.chains=2"
    ).done()
    table = done.parameters
    for name, value in {"gain_roof": GAIN, "offset_roof": OFFSET, "delay_roof": DELAY / 60.0}.items():
        assert abs(table.loc[name, "estimate"] - value) < 4.0 * table.loc[name, "std"], name
    assert table.loc["gain_roof", "std"] < 0.02
    with xr.open_datatree(done.directory / "posterior.nc", engine="h5netcdf") as posterior:
        assert posterior["posterior"]["delay_roof"].shape == (2, 1000)
        assert posterior["posterior"]["delay_roof"].attrs["units"] == "s"
