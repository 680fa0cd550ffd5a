"""Structures whose modes have damping ratios, in records of other code, from the command to the files."""

import numpy as np
import pandas as pd
import pytest
from calls import PinnRun
from scipy.linalg import eigh
from storeys import chain_matrix, under_waves

MASS, RATE = 2000.0, 100.0
K, ZETA = np.array([1.5e6, 1.4e6, 1.2e6]), np.array([0.02, 0.015, 0.025])


def chain_of_ratios(seed: int, duration: float) -> dict[str, np.ndarray]:
    """Columns of accelerometers on three storeys under a force on the roof, 40 dB."""
    rng, stiffness = np.random.default_rng(seed), chain_matrix(K)
    squares, shapes = eigh(stiffness, MASS * np.eye(3))
    damping = MASS**2 * shapes @ np.diag(2.0 * ZETA * np.sqrt(squares)) @ shapes.T
    waves = 2.0 * np.pi * rng.uniform(0.3, 15.0, 40), rng.uniform(0.0, 2.0 * np.pi, 40)
    time = np.arange(round(duration * RATE)) / RATE
    acting = np.array([0.0, 0.0, 80.0])
    _, _, a, force = under_waves(np.full(3, MASS), (damping, stiffness), acting, waves, time, RATE)
    columns = {"f": 80.0 * force, **{f"a{i + 1}": a[:, i] for i in range(3)}}
    noisy = {name: x + 0.01 * np.std(x) * rng.standard_normal(len(x)) for name, x in columns.items()}
    return {"t": time, **noisy}


RECORD = (
    "data=csv", "data.time=t", "data.force={3: f}", "data.acceleration={1: a1, 2: a2, 3: a3}", "system=linear",
    "system.ndof=3", f"system.m={MASS}", "scheme=state_parameter", "scheme.unknown=missing", "figures=false",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_stiffnesses_and_ratios_are_found_together(pinn_run: PinnRun, tmp_path, seed):
    path = tmp_path / "record.csv"
    pd.DataFrame(chain_of_ratios(seed, 20.0)).to_csv(path, index=False)
    outcome = pinn_run(*RECORD, f"data.path={path}", "system.damping={ratio: [null, null, null]}").done()
    found = outcome.parameters
    true = {f"k_{i + 1}": k for i, k in enumerate(K)} | {f"zeta_{i + 1}": zeta for i, zeta in enumerate(ZETA)}
    for name, value in true.items():
        row = found.loc[name]
        assert abs(row["estimate"] / value - 1.0) < (1e-3 if name.startswith("k") else 0.03), name
        assert abs(row["estimate"] - value) < 4.0 * row["std"] < 0.2 * value, name
    modes = pd.read_csv(outcome.directory / "modes.csv")
    np.testing.assert_allclose(modes["damping_ratio"], [found.loc[f"zeta_{i}", "estimate"] for i in (1, 2, 3)])
    assert outcome.record["verdict"] == "sound", outcome.out


@pytest.mark.slow
def test_dampers_between_the_masses_are_doubted(pinn_run: PinnRun, tmp_path):
    path = tmp_path / "record.csv"
    pd.DataFrame(chain_of_ratios(2, 20.0)).to_csv(path, index=False)
    outcome = pinn_run(*RECORD, f"data.path={path}", "scheme.unknown=[k_*, c_*]")
    ran = outcome.record
    assert ran["verdict"] != "sound", outcome.out
    assert any("the damping ratio of mode" in reason for reason in ran["reasons"])


@pytest.mark.slow
@pytest.mark.parametrize("windows", [(), ("data.window=10", "data.overlap=2")], ids=["whole", "windows"])
def test_without_a_word_each_mode_in_the_band_has_a_ratio(pinn_run: PinnRun, tmp_path, windows):
    path = tmp_path / "record.csv"
    pd.DataFrame(chain_of_ratios(3, 20.0)).to_csv(path, index=False)
    outcome = pinn_run(*RECORD, f"data.path={path}", "scheme.unknown=[k_*]", *windows).done()
    assert "nothing is said of damping" in outcome.out + outcome.err
    found = outcome.parameters
    np.testing.assert_allclose(
        [found.loc[f"zeta_{i}", "estimate"] for i in (1, 2, 3)], ZETA, rtol=0.05 if windows else 0.03
    )
