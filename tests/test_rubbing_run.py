"""A contact that rubs against the ground while the structure stands on a base that moves; the record by scipy alone."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calls import PinnRun
from rubbing_records import C, K, rubbing

RATE, DURATION = 200.0, 12.0
SYSTEM = (
    "data=csv", "data.time=t", "figures=false", "system=structure", "system.dofs=[mass]", "system.supports=[base]",
    "scheme=state_parameter", "scheme.unknown=missing",
    "data.channels={b: {sensor: displacement, support: base}, x: {sensor: displacement, dof: mass}}",
)  # fmt: skip


def written(path: Path, seed: int, mass: float, friction: float, db: float = 50.0) -> Path:
    rng, time = np.random.default_rng(seed + 1000), np.arange(round(RATE * DURATION)) / RATE
    noisy = {
        name: x + 10.0 ** (-db / 20.0) * np.sqrt(np.mean(x**2)) * rng.standard_normal(len(x))
        for name, x in zip("bx", rubbing(time, seed, mass, friction), strict=True)
    }
    pd.DataFrame({"t": time, **noisy}).to_csv(path, index=False)
    return path


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "mass", "friction"), [(11, 1.0, 0.7), (12, 3.0, 1.0), (13, 2.4, 1.3), (14, 1.4, 1.7)])
def test_a_contact_with_what_stands_still(pinn_run: PinnRun, tmp_path, seed, mass, friction) -> None:
    """Friction, stiffness and damper within their intervals, which are narrow: sliding tells them."""
    contact = "rub: {between: [ground, mass], law: friction, c: 0, k: 0, F_c: null}"
    outcome = pinn_run(
        *SYSTEM, f"data.path={written(tmp_path / 'seen.csv', seed, mass, friction)}", f"system.mass={{mass: {mass}}}",
        f"system.connections={{spring: {{between: [base, mass], law: linear, c: null, k: null}}, {contact}}}",
    )  # fmt: skip
    assert outcome.status == 0, outcome.err
    run = json.loads((outcome.directory / "run.json").read_text())
    # In one of the four records what a spline leaves where the contact turns passes for a mode of 1e-3 kg, or keeps the
    # training from an end: which of them is up to rounding.
    excused = ("a mode at", "iteration limit") if seed == 13 else ()
    assert [reason for reason in run["reasons"] if not any(words in reason for words in excused)] == []
    assert run["verdict"] == ("questionable" if seed == 13 else "sound")
    found = pd.read_csv(outcome.directory / "parameters.csv").set_index("parameter")
    for name, true, known in (("F_c_rub", friction, 0.02), ("k_spring", K, 0.005), ("c_spring", C, 0.05)):
        row = found.loc[name]
        assert abs(row["estimate"] - true) < 4.0 * row["std"], row
        assert row["std"] < known * true, row
    free = pd.read_csv(outcome.directory / "free_run.csv").set_index(["against", "group", "quantity"])
    assert free.loc[("estimate", "all", "displacement"), "fitness_percent"] > 95.0
