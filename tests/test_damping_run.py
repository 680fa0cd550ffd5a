"""Structures whose modes have damping ratios, in records of other code, from the command to the files."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from calls import PinnRun
from scipy.linalg import eigh, expm

MASS, RATE = 2000.0, 100.0
K, ZETA = np.array([1.5e6, 1.4e6, 1.2e6]), np.array([0.02, 0.015, 0.025])


def chain_of_ratios(seed: int, duration: float) -> dict[str, np.ndarray]:
    """Columns of accelerometers on three storeys under a force on the roof, 40 dB; each sinusoid of it is a state."""
    rng = np.random.default_rng(seed)
    stiffness = np.diag(K + np.append(K[1:], 0.0)) - np.diag(K[1:], 1) - np.diag(K[1:], -1)
    squares, shapes = eigh(stiffness, MASS * np.eye(3))
    damping = MASS**2 * shapes @ np.diag(2.0 * ZETA * np.sqrt(squares)) @ shapes.T
    omega = 2.0 * np.pi * rng.uniform(0.3, 15.0, 40)
    generator = np.zeros((86, 86))
    generator[:3, 3:6] = np.eye(3)
    generator[3:6, :3], generator[3:6, 3:6] = -stiffness / MASS, -damping / MASS
    cosine = 6 + 2 * np.arange(40)
    generator[5, cosine] = 80.0 / MASS
    generator[cosine, cosine + 1], generator[cosine + 1, cosine] = -omega, omega
    state = np.zeros(86)
    phase = rng.uniform(0.0, 2.0 * np.pi, 40)
    state[cosine], state[cosine + 1] = np.cos(phase), np.sin(phase)
    step, states = expm(generator / RATE), []
    for _ in range(round(duration * RATE)):
        states.append(state)
        state = step @ state
    found = np.array(states)
    columns = {"f": 80.0 * found[:, cosine].sum(axis=1)}
    columns |= {f"a{i + 1}": (found @ generator.T)[:, 3 + i] for i in range(3)}
    noisy = {name: x + 0.01 * np.std(x) * rng.standard_normal(len(x)) for name, x in columns.items()}
    return {"t": np.arange(len(found)) / RATE, **noisy}


RECORD = (
    "data=csv", "data.time=t", "data.force={3: f}", "data.acceleration={1: a1, 2: a2, 3: a3}", "system=linear",
    "system.ndof=3", f"system.m={MASS}", "scheme=state_parameter", "scheme.unknown=missing", "figures=false",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_stiffnesses_and_ratios_are_found_together(pinn_run: PinnRun, tmp_path, seed):
    path = tmp_path / "record.csv"
    pd.DataFrame(chain_of_ratios(seed, 20.0)).to_csv(path, index=False)
    outcome = pinn_run(*RECORD, f"data.path={path}", "system.damping={ratio: [null, null, null]}")
    assert outcome.status == 0, outcome.err
    found = pd.read_csv(outcome.directory / "parameters.csv", index_col="parameter")
    true = {f"k_{i + 1}": k for i, k in enumerate(K)} | {f"zeta_{i + 1}": zeta for i, zeta in enumerate(ZETA)}
    for name, value in true.items():
        row = found.loc[name]
        assert abs(row["estimate"] / value - 1.0) < (1e-3 if name.startswith("k") else 0.03), name
        assert abs(row["estimate"] - value) < 4.0 * row["std"] < 0.2 * value, name
    modes = pd.read_csv(outcome.directory / "modes.csv")
    np.testing.assert_allclose(modes["damping_ratio"], [found.loc[f"zeta_{i}", "estimate"] for i in (1, 2, 3)])
    assert json.loads((outcome.directory / "run.json").read_text())["verdict"] == "sound", outcome.out


@pytest.mark.slow
def test_dampers_between_the_masses_are_doubted(pinn_run: PinnRun, tmp_path):
    path = tmp_path / "record.csv"
    pd.DataFrame(chain_of_ratios(2, 20.0)).to_csv(path, index=False)
    outcome = pinn_run(*RECORD, f"data.path={path}", "scheme.unknown=[k_*, c_*]")
    ran = json.loads((outcome.directory / "run.json").read_text())
    assert ran["verdict"] != "sound", outcome.out
    assert any("with a damping ratio for each mode the record is e^" in reason for reason in ran["reasons"])


@pytest.mark.slow
def test_without_a_word_each_mode_in_the_band_has_a_ratio(pinn_run: PinnRun, tmp_path):
    path = tmp_path / "record.csv"
    pd.DataFrame(chain_of_ratios(3, 20.0)).to_csv(path, index=False)
    outcome = pinn_run(*RECORD, f"data.path={path}", "scheme.unknown=[k_*]")
    assert outcome.status == 0, outcome.err
    assert "nothing is said of damping" in outcome.out + outcome.err
    found = pd.read_csv(outcome.directory / "parameters.csv", index_col="parameter")
    np.testing.assert_allclose([found.loc[f"zeta_{i}", "estimate"] for i in (1, 2, 3)], ZETA, rtol=0.03)


@pytest.mark.slow
def test_windows_without_a_word_learn_the_same_ratios(pinn_run: PinnRun, tmp_path):
    path = tmp_path / "record.csv"
    pd.DataFrame(chain_of_ratios(3, 20.0)).to_csv(path, index=False)
    outcome = pinn_run(*RECORD, f"data.path={path}", "scheme.unknown=[k_*]", "data.window=10", "data.overlap=2")
    assert outcome.status == 0, outcome.err
    assert "nothing is said of damping" in outcome.out + outcome.err
    found = pd.read_csv(outcome.directory / "parameters.csv", index_col="parameter")
    np.testing.assert_allclose([found.loc[f"zeta_{i}", "estimate"] for i in (1, 2, 3)], ZETA, rtol=0.05)
