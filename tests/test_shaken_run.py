"""A frame in an earthquake, from the command to the files: sensors on the ground and on the roof."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from calls import PinnRun
from scipy.integrate import solve_ivp
from scipy.signal import butter, lsim, sosfilt, sosfiltfilt
from storeys import chain_matrix, under_waves

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


def test_an_earthquake_that_nobody_measured(pinn_run: PinnRun, tmp_path: Path) -> None:
    """Displacements relative to the ground, a cubic storey, by other code: all of the structure, and the ground."""
    rng, time, (m1, m2) = np.random.default_rng(5), np.arange(0, 30, 1e-3), (2.6e4, 2.2e4)
    ground = sosfilt(butter(2, [0.3, 6], "bandpass", fs=1000, output="sos"), rng.standard_normal(len(time)))
    true = {"k_low": 9e6, "k_high": 7e6, "c_low": 6e4, "c_high": 5e4, "kappa_low": 2e10}

    def rate(at, y):
        e, de = np.array([y[0], y[1] - y[0]]), np.array([y[2], y[3] - y[2]])
        low = true["k_low"] * e[0] + true["c_low"] * de[0] + true["kappa_low"] * e[0] ** 3
        high = true["k_high"] * e[1] + true["c_high"] * de[1]
        shaken = np.interp(at, time, ground)
        return [y[2], y[3], (high - low) / m1 - shaken, -high / m2 - shaken]

    moved = solve_ivp(rate, (0.0, time[-1]), np.zeros(4), "DOP853", time[::20], rtol=1e-8, max_step=5e-3).y[:2].T
    seen = moved + 0.003 * moved.std(axis=0) * rng.standard_normal(moved.shape)
    table = pd.DataFrame({"t": time[::20], "u1": seen[:, 0], "u2": seen[:, 1]})
    table.to_csv(tmp_path / "rig.csv", index=False)
    low = "low: {between: [ground, a], law: duffing, c: null, k: null, kappa: null}"
    high = "high: {between: [a, b], law: linear, c: null, k: null}"
    outcome = pinn_run(
        "data=csv", f"data.path={tmp_path}/rig.csv", "data.displacement={a: u1, b: u2}",
        "data.ground_acceleration=unmeasured", "system=structure", "system.dofs=[a,b]",
        f"system.mass={{a: {m1}, b: {m2}}}", f"+system.connections={{{low}, {high}}}",
        "scheme=state_parameter", "scheme.unknown=missing", "scheme.initial_motion=rest", "figures=false",
    ).done()  # fmt: skip
    assert outcome.record["verdict"] == "sound", outcome.out
    found = outcome.parameters
    off = (found["estimate"] - pd.Series(true)).loc[list(true)]
    assert (off.abs() < 3.5 * found.loc[list(true), "std"]).all()
    assert (off.abs() < [0.01 * true["k_low"], 0.01 * true["k_high"], 1e4, 1e4, 0.05 * true["kappa_low"]]).all()
    with xr.open_dataset(outcome.directory / "response.nc") as response:
        slow = butter(4, 4.0, fs=50, output="sos")
        known, estimate = (sosfiltfilt(slow, x) for x in (ground[::20], response["ground_acceleration"].to_numpy()))
        assert np.mean((known - estimate) ** 2) < 0.05 * np.var(known)
        assert "ground_acceleration_observed" not in response


@pytest.mark.slow
@pytest.mark.parametrize("sensors", [(1, 2, 3), (1, 3)])
def test_an_earthquake_whose_ground_record_is_missing(
    pinn_run: PinnRun, tmp_path: Path, sensors: tuple[int, ...]
) -> None:
    """Absolute accelerations: the lowest storey is told by the spectrum of the ground alone."""
    rng, m, k, time = np.random.default_rng(3), np.array([26e3, 24e3, 23e3]), [30e6, 21e6, 23e6], np.arange(0, 60, 5e-4)
    ground = sosfilt(butter(2, [0.3, 12], "bandpass", fs=2000, output="sos"), rng.standard_normal(len(time)))
    stretch = np.eye(3) - np.eye(3, k=-1)
    k_over_m = stretch.T @ np.diag(k) @ stretch / m[:, None]
    rates = np.hstack((-k_over_m, -3e-3 * k_over_m))
    a = np.vstack((np.hstack((np.zeros((3, 3)), np.eye(3))), rates))
    _, moved, _ = lsim((a, np.repeat([[0.0], [-1.0]], 3, axis=0), rates, np.zeros((3, 1))), ground, time)
    felt = moved[::20]
    felt = felt + 0.01 * felt.std(axis=0) * rng.standard_normal(felt.shape)
    table = pd.DataFrame({"t": time[::20]} | {f"a{dof}": felt[:, dof - 1] for dof in sensors})
    table.to_csv(tmp_path / "rig.csv", index=False)
    outcome = pinn_run(
        "data=csv", f"data.path={tmp_path}/rig.csv", "data.ground_acceleration=unmeasured",
        f"data.acceleration={{{', '.join(f'{dof}: a{dof}' for dof in sensors)}}}", "system=linear", "system.ndof=3",
        f"system.m={m.tolist()}", "scheme=state_parameter", "scheme.unknown=[k_*, c_*]", "figures=false",
    )  # fmt: skip
    found = outcome.parameters
    assert found.loc[["k_2", "k_3"], "estimate"].to_numpy() == pytest.approx(k[1:], rel=0.01)
    off = found["estimate"] - pd.Series(
        {f"{kind}_{i + 1}": x for i, x in enumerate(k) for kind, x in (("k", x), ("c", 3e-3 * x))}
    )
    assert (off.abs() < 4.0 * found["std"]).all()
    assert outcome.record["verdict"] != "failed"


M = np.array([1e4, 1e4, 1e4, 8e3])
K = np.array([9e6, 8e6, 7e6, 6e6])
C = 1.2e-3 * K
RATE, DURATION = 100.0, 20.0


def shaken(seed: int, highest: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (N,), ground acceleration (N,), and (N, 3, 4) displacement, velocity, acceleration relative to the ground.

    From rest under sinusoids.
    """
    rng, size = np.random.default_rng([seed, 3]), 1.5 * np.sqrt(2.0 / 120)
    waves = 2.0 * np.pi * rng.uniform(0.3, highest, 120), rng.uniform(0.0, 2.0 * np.pi, 120)
    time = np.arange(round(DURATION * RATE)) / RATE
    *motion, ground = under_waves(M, (chain_matrix(C), chain_matrix(K)), -size * M, waves, time, RATE)
    return time, size * ground, np.stack(motion, 1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("frame", "highest", "ground_db"), [("relative", 35.0, 20.0), ("absolute", 40.0, 40.0), ("relative", 45.0, 40.0)]
)
def test_springs_dampers_and_bands(pinn_run: PinnRun, tmp_path, frame, highest, ground_db):
    time, ground, motion = shaken(1, highest)
    rng = np.random.default_rng(2)
    noisy = lambda x, db: x + x.std() * 10.0 ** (-db / 20.0) * rng.normal(size=len(x))  # noqa: E731
    felt = motion[:, 2] + (ground[:, None] if frame == "absolute" else 0.0)
    columns = {"t": time, "g": noisy(ground, ground_db), "a2": noisy(felt[:, 1], 40.0), "a4": noisy(felt[:, 3], 40.0)}
    pd.DataFrame(columns).to_csv(tmp_path / "shaken.csv", index=False)
    outcome = pinn_run(
        "data=csv", f"data.path={tmp_path / 'shaken.csv'}", "data.time=t", "data.ground_acceleration=g",
        f"data.frame={frame}", "data.acceleration={2: a2, 4: a4}", "system=linear", "system.ndof=4",
        "system.m=[1e4,1e4,1e4,8e3]", "system.k=8e6", "system.c=1e4", "scheme=state_parameter",
        "scheme.unknown=[k_*,c_*]", "figures=false",
    ).done()  # fmt: skip
    found = outcome.parameters
    for kind, truth in (("k", K), ("c", C)):
        rows = found.loc[[f"{kind}_{i + 1}" for i in range(4)]]
        assert np.max(np.abs(rows["estimate"] - truth) / rows["std"]) < 4.0
    with xr.open_dataset(outcome.directory / "response.nc") as response:
        for quantity, truth in (("displacement", motion[:, 0]), ("velocity", motion[:, 1]), ("acceleration", felt)):
            off = response[quantity].values - truth
            assert np.mean(np.abs(off) < 1.96 * response[f"{quantity}_std"].values) > 0.8, quantity
    run = outcome.record
    noise = ground.std() * 10.0 ** (-ground_db / 20.0)
    assert run["training"]["sigma_ground_acceleration"][0] == pytest.approx(noise, rel=0.35)
    assert run["verdict"] == "sound", run["reasons"]
