"""A contact that rubs against the ground while the structure stands on a base that moves; the record by scipy alone."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calls import PinnRun
from scipy.optimize import brentq

RATE, DURATION = 200.0, 12.0
SYSTEM = (
    "data=csv", "data.time=t", "figures=false", "system=structure", "system.dofs=[mass]", "system.supports=[base]",
    "scheme=state_parameter", "scheme.unknown=missing",
    "data.channels={b: {sensor: displacement, support: base}, x: {sensor: displacement, dof: mass}}",
)  # fmt: skip

K, C, WAVES = 1150.0, 2.0, 12
# Steps of the search for the end of a swing or of sticking, and how far it looks at once, s.
LOOK, AHEAD = 1e-3, 0.25


def rubbing(time: np.ndarray, seed: int, mass: float, friction: float) -> tuple[np.ndarray, np.ndarray]:
    """Displacement of the base, some mm of 1 to 5 Hz, and of the mass, each (N,), m: Coulomb's friction to the ground.

    The base moves the mass by a spring `K` and a damper `C`. It begins where it is held.
    """
    rng = np.random.default_rng(seed)
    frequency = rng.uniform(1.0, 5.0, WAVES)
    omega, phase = 2.0 * np.pi * frequency, np.exp(2j * np.pi * rng.random(WAVES))
    waves = 3e-3 * np.sqrt(2.0 / WAVES) * 2.5 / frequency * phase
    flexible = K + 1j * omega * C
    steady_waves, roots = waves * flexible / (flexible - mass * omega**2), np.roots([mass, C, K])
    out, place, begin = np.zeros(len(time)), 0.0, float(time[0])

    def moved(t: np.ndarray, size: np.ndarray, order: int = 0) -> np.ndarray:
        return (np.exp(1j * np.multiply.outer(t, omega)) @ (size * (1j * omega) ** order)).real

    def pull(t: np.ndarray) -> np.ndarray:
        return K * (moved(t, waves) - place) + C * moved(t, waves, 1)

    def first_above_zero(of: Callable[[np.ndarray], np.ndarray]) -> float:
        for first in np.arange(begin, time[-1], AHEAD):
            grid = first + 1e-9 + LOOK * np.arange(round(AHEAD / LOOK) + 1)
            above = np.flatnonzero(of(grid) > 0)
            if above.size:
                i = above[0]
                return brentq(lambda t: float(of(np.array(t))), grid[i - 1], grid[i], xtol=1e-14) if i else grid[0]
        return np.inf

    while begin < time[-1]:
        now = np.array(begin)
        if abs(pull(now)) <= friction:
            end = first_above_zero(lambda t: np.abs(pull(t)) - friction)
            out[(time >= begin) & (time < end)] = place
        else:
            side = np.sign(pull(now))
            held = side * friction / K
            free = np.linalg.solve(
                [np.ones(2), roots], [place - moved(now, steady_waves) + held, -moved(now, steady_waves, 1)]
            )

            def swing(t: np.ndarray, order: int = 0, held=held, free=free, begin=begin) -> np.ndarray:
                decays = (np.exp(np.multiply.outer(t - begin, roots)) @ (free * roots**order)).real
                return moved(t, steady_waves, order) + decays - (held if order == 0 else 0.0)

            end = first_above_zero(lambda t: -side * swing(t, 1))  # noqa: B023
            within = (time >= begin) & (time < end)
            out[within] = swing(time[within])
            place = float(swing(np.array(end))) if np.isfinite(end) else place
        begin = end
    return moved(time, waves), out


def written(path: Path, seed: int, mass: float, friction: float, db: float = 50.0) -> Path:
    rng, time = np.random.default_rng(seed + 1000), np.arange(round(RATE * DURATION)) / RATE
    noisy = {
        name: x + 10.0 ** (-db / 20.0) * np.sqrt(np.mean(x**2)) * rng.standard_normal(len(x))
        for name, x in zip("bx", rubbing(time, seed, mass, friction), strict=True)
    }
    pd.DataFrame({"t": time, **noisy}).to_csv(path, index=False)
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "mass", "friction", "damper"), [(11, 1.0, 0.7, 0.05), (12, 3.0, 1.0, 0.05), (14, 1.4, 1.7, 0.1)]
)
def test_a_contact_with_what_stands_still(pinn_run: PinnRun, tmp_path, seed, mass, friction, damper) -> None:
    """Friction, stiffness and damper within their intervals, which are narrow: sliding tells them.

    One that sticks most of the time tells less of the damper.
    """
    contact = "rub: {between: [ground, mass], law: friction, c: 0, k: 0, F_c: null}"
    outcome = pinn_run(
        *SYSTEM, f"data.path={written(tmp_path / 'seen.csv', seed, mass, friction)}", f"system.mass={{mass: {mass}}}",
        f"system.connections={{spring: {{between: [base, mass], law: linear, c: null, k: null}}, {contact}}}",
    ).done()  # fmt: skip
    run = outcome.record
    assert (run["verdict"], run["reasons"]) == ("sound", [])
    found = outcome.parameters
    for name, true, known in (("F_c_rub", friction, 0.02), ("k_spring", K, 0.005), ("c_spring", C, damper)):
        row = found.loc[name]
        assert abs(row["estimate"] - true) < 4.0 * row["std"], row
        assert row["std"] < known * true, row
    free = pd.read_csv(outcome.directory / "free_run.csv").set_index(["against", "group", "quantity"])
    assert free.loc[("estimate", "all", "displacement"), "fitness_percent"] > 95.0
