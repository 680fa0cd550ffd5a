"""Sensors in doubt, and several records with an accelerometer that roves, through the whole program."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from calls import PinnRun
from independent_records import frame, frame_record

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


TRUTH = frame().k
FRAME = ("data=csv", "system=linear", "system.ndof=3", "system.m=2000", "system.c=[3000,2800,2400]", "figures=false")
UNKNOWN = ("scheme=state_parameter", "scheme.unknown=k_*", "scheme.parameter_uncertainty=0")


def write(folder: Path, duration: float, snr_db: float, force_gain: float = 1.0) -> None:
    """A file for every storey, with the roof's force and that storey's acceleration, of motions of their own."""
    for storey in (1, 2, 3):
        made = frame_record(
            cubic=False, duration=duration, snr_db=snr_db, sensors=(("acceleration", (storey,)),), seed=storey
        ).record
        columns = {"t": made.time, "f": force_gain * made.force[:, 2], "a": made.acceleration[:, storey - 1]}
        pd.DataFrame(columns).to_csv(folder / f"storey_{storey}.csv", index=False)


@pytest.mark.slow
def test_three_records_make_one_report(pinn_run: PinnRun, tmp_path: Path) -> None:
    write(tmp_path, duration=6.0, snr_db=30.0)
    paths = [tmp_path / f"storey_{storey}.csv" for storey in (1, 2, 3)]
    records = ",".join(f"{{path: '{path}', acceleration: {{{i}: a}}}}" for i, path in enumerate(paths, start=1))
    fresh = frame_record(cubic=False, duration=6.0, snr_db=30.0, seed=4).record
    columns = {"t": fresh.time, "f": fresh.force[:, 2], **{f"a{i + 1}": fresh.acceleration[:, i] for i in range(3)}}
    pd.DataFrame(columns).to_csv(tmp_path / "fresh.csv", index=False)
    other = f"data.validation={{path: '{tmp_path}/fresh.csv', acceleration: {{1: a1, 2: a2, 3: a3}}}}"
    settings = "data.force={3: f}", f"data.records=[{records}]", other, f"hydra.run.dir={tmp_path}/run"
    command = (*FRAME, *UNKNOWN, *settings)
    done = pinn_run(*command).done()
    found = done.parameters
    assert list(found.index) == ["k_1", "k_2", "k_3"]
    assert np.all(np.abs(found["estimate"] / TRUTH - 1.0) < 0.02)
    summary = pd.read_csv(done.directory / "records.csv")
    assert list(summary["folder"]) == [".", "record_2", "record_3"]
    assert list(summary["samples"]) == [600, 600, 600]
    run = done.record
    assert len(run["records"]) == 3
    assert run["records"][1]["sigma_acceleration"][0] is None
    tried = pd.read_csv(done.directory / "validation.csv")
    assert list(tried["dof"]) == [1, 2, 3]
    assert np.all(tried["nmse_percent"] < 1.0)
    assert np.all(tried["inside_95_percent"].between(85.0, 100.0))
    measured = fresh.acceleration.std(axis=0)
    assert np.all(np.abs(tried["sigma"] / measured / 10.0**-1.5 - 1.0) < 0.25)  # each as its own record showed it
    for folder, storey in zip(summary["folder"], (1, 2, 3), strict=True):
        residuals = pd.read_csv(done.directory / folder / "residuals.csv")
        assert list(zip(residuals["quantity"], residuals["dof"], strict=True)) == [
            ("acceleration", storey),
            ("force", 3),
        ]
        with xr.open_dataset(done.directory / folder / "response.nc") as response:
            measured = pd.read_csv(paths[storey - 1])["a"]
            np.testing.assert_allclose(response["acceleration_observed"][:, storey - 1], measured)
        assert (done.directory / folder / "fitness.csv").is_file()
        assert (done.directory / folder / "parameters.csv").is_file() == (folder == ".")
    assert "2      acceleration 2" in done.out
    again = pinn_run(*command, "resume=auto")
    assert "finished before" in again.out


@pytest.mark.slow
def test_a_roving_accelerometer_and_a_load_cell_of_unknown_gain(pinn_run: PinnRun, tmp_path: Path) -> None:
    """Together the records tell every stiffness to a per cent, and each on its own to two."""
    write(tmp_path, duration=20.0, snr_db=20.0, force_gain=1.1)

    def entry(storey: int) -> str:
        load_cell, roving = "f: {sensor: force, dof: 3, gain: unknown}", f"a: {{sensor: acceleration, dof: {storey}}}"
        return f"path: '{tmp_path}/storey_{storey}.csv', channels: {{{load_cell}, {roving}}}"

    alone = []
    for storey in (1, 2, 3):
        path, _, channels = entry(storey).partition(", channels: ")
        done = pinn_run(
            *FRAME, *UNKNOWN, f"data.path={path.removeprefix('path: ')}", f"data.channels={channels}"
        ).done()
        alone.append(done.parameters["estimate"][["k_1", "k_2", "k_3"]].to_numpy())
    records = ",".join(f"{{{entry(storey)}}}" for storey in (1, 2, 3))
    done = pinn_run(*FRAME, *UNKNOWN, f"data.records=[{records}]").done()
    found = done.parameters["estimate"]
    assert list(found.index) == ["k_1", "k_2", "k_3", "gain_f"]
    assert np.all(np.abs(found[["k_1", "k_2", "k_3"]].to_numpy() / TRUTH - 1.0) < 0.01)
    # They did not agree while a load cell of unknown gain kept its noise in a free run.
    assert np.all(np.abs(np.array(alone) / TRUTH - 1.0) < 0.02), alone
