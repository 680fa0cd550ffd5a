"""Ground motion with content nearly up to the Nyquist frequency: springs, dampers and bands; records by scipy alone."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from calls import PinnRun
from storeys import chain_matrix, under_waves

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
