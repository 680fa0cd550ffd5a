"""A law that nobody knows, found as a curve with its band; the record by scipy alone."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from ambient_records import white_below
from calls import PinnRun
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline

RATE, DURATION, DB = 100.0, 30.0, 30.0
MASS, STIFFNESS, DAMPING, HARDENING = 1500.0, 6.0e5, 900.0, 4.0e9
SYSTEM = (
    "data=csv", "data.time=t", "system=structure", "system.dofs=[x]", f"system.mass={{x: {MASS}}}",
    "scheme=state_parameter", "scheme.unknown=missing",
    "data.channels={f: {sensor: force, dof: x}, a: {sensor: acceleration, dof: x}}",
)  # fmt: skip


def law(e: np.ndarray) -> np.ndarray:
    """Stiffer one way than the other, and hardening."""
    return STIFFNESS * e + 1.0e7 * e**2 + HARDENING * e**3


def written(path: Path) -> Path:
    rng, time = np.random.default_rng(11), np.arange(round(RATE * DURATION)) / RATE
    force = 2000.0 * white_below(12.0, RATE, time.shape, rng)
    pushed = make_interp_spline(time, force, 5)

    def rates(t: float, state: np.ndarray) -> np.ndarray:
        return np.array([state[1], (pushed(t) - law(state[0]) - DAMPING * state[1]) / MASS])

    solved = solve_ivp(rates, time[[0, -1]], np.zeros(2), t_eval=time, max_step=0.2 / RATE, rtol=1e-8, atol=1e-11)
    felt = np.array([rates(t, state)[1] for t, state in zip(time, solved.y.T, strict=True)])
    columns = {"f": force, "x": solved.y[0], "a": felt}
    noisy = {name: x + 10.0 ** (-DB / 20.0) * x.std() * rng.standard_normal(len(x)) for name, x in columns.items()}
    pd.DataFrame({"t": time} | noisy).to_csv(path, index=False)
    return path


@pytest.mark.slow
def test_a_law_that_nobody_knows_lies_in_its_band(pinn_run: PinnRun, tmp_path: Path):
    path = written(tmp_path / "spring.csv")
    joined = "{spring: {between: [ground, x], law: spline, elongation: 0.03}}"
    seen = "data.channels.x={sensor: displacement, dof: x}"
    outcome = pinn_run(*SYSTEM, seen, f"system.connections={joined}", f"data.path={path}", "hydra.run.dir=run").done()
    curves = pd.read_csv(outcome.directory / "restoring.csv").set_index("over")
    assert set(curves["connection"]) == {"spring"}
    assert outcome.record["verdict"] == "sound"
    over, speed = curves.loc["elongation"], curves.loc["speed"]
    apart = np.abs(over["force"] - law(over["at"].to_numpy()))
    assert np.mean(apart <= 1.96 * over["std"]) > 0.9
    assert over["std"].median() < 0.02 * over["force"].abs().max()
    assert np.all(np.abs(speed["force"] - DAMPING * speed["at"]) <= 4.0 * speed["std"] + 1e-9)
    assert (outcome.directory / "figures" / "restoring.png").is_file()
