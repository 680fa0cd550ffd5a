"""A contact that closes, its stiffness and its gap unknown; the record by scipy alone."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from ambient_records import white_below
from calls import PinnRun
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline

RATE, DURATION, DB = 100.0, 20.0, 40.0
MASS, TRUE = (3.8, 3.9), {"c_wall": 3.8, "k_wall": 2300.0, "c_stop": 4.2, "k_stop": 1600.0, "k_g_stop": 1800.0}
SYSTEM = (
    "data=csv", "data.time=t", "figures=false", "system=structure", "system.dofs=[a, b]",
    f"system.mass={{a: {MASS[0]}, b: {MASS[1]}}}", "scheme=state_parameter", "scheme.unknown=missing",
    "data.channels={f: {sensor: force, dof: b}, a: {sensor: acceleration, dof: a}, b: {sensor: acceleration, dof: b}}",
)  # fmt: skip


def written(path: Path, sides: str, gap: float) -> Path:
    rng, time = np.random.default_rng(7), np.arange(round(RATE * DURATION)) / RATE
    force = 60.0 * white_below(12.0, RATE, time.shape, rng)
    pushed = make_interp_spline(time, force, 5)

    def rates(t: float, state: np.ndarray) -> np.ndarray:
        (x, y), (v, w) = state[:2], state[2:]
        e = y - x
        contact = max(e - gap, 0.0) * (sides != "negative") - max(-e - gap, 0.0) * (sides != "positive")
        wall = TRUE["c_wall"] * v + TRUE["k_wall"] * x
        stop = TRUE["c_stop"] * (w - v) + TRUE["k_stop"] * e + TRUE["k_g_stop"] * contact
        return np.array([v, w, (stop - wall) / MASS[0], (pushed(t) - stop) / MASS[1]])

    solved = solve_ivp(rates, time[[0, -1]], np.zeros(4), t_eval=time, max_step=0.2 / RATE, rtol=1e-8, atol=1e-11)
    felt = np.array([rates(t, state)[2:] for t, state in zip(time, solved.y.T, strict=True)])
    columns = {"f": force, "a": felt[:, 0], "b": felt[:, 1]}
    noisy = {name: x + 10.0 ** (-DB / 20.0) * x.std() * rng.standard_normal(len(x)) for name, x in columns.items()}
    pd.DataFrame({"t": time} | noisy).to_csv(path, index=False)
    return path


@pytest.mark.slow
@pytest.mark.parametrize(("sides", "gap"), [("both", 0.03), ("negative", 0.05)])
def test_stiffness_and_gap_of_a_contact_are_identified(pinn_run: PinnRun, tmp_path: Path, sides: str, gap: float):
    joined = f"{{wall: {{between: [ground, a], law: linear}}, stop: {{between: [a, b], law: gap, sides: {sides}}}}}"
    path = written(tmp_path / "stop.csv", sides, gap)
    outcome = pinn_run(*SYSTEM, f"system.connections={joined}", f"data.path={path}", "hydra.run.dir=run").done()
    table = outcome.parameters
    for name, true in (TRUE | {"gap_stop": gap}).items():
        estimate, std = table.loc[name, ["estimate", "std"]]
        assert abs(estimate - true) < 4.0 * std, name
        assert std < 0.02 * true, name
