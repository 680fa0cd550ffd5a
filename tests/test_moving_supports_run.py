"""Structures on supports that move, some of which rub, from the command to the files; the records by scipy alone."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from calls import PinnRun
from scipy.optimize import brentq

M, RATE, DURATION, WAVES = np.array([450.0, 300.0]), 50.0, 16.0, 60
TRUE = {"mount": (9e4, 300.0), "hinge": (6e4, 200.0), "pipe": (2e4, 60.0)}
MOUNT = "mount: {between: [table, frame], law: linear, c: 200, k: 1.3e5}"
HINGE = "hinge: {between: [frame, arm], law: linear, c: 300, k: 4e4}"
PIPE = "pipe: {between: [ground, arm], law: linear, c: 90, k: 1.5e4}"
S = "s: {sensor: displacement, support: table}"
NO_DAMPERS = [f"system.connections.{name}.c=null" for name in TRUE]
SYSTEM = (
    "system=structure", "system.dofs=[frame,arm]", "system.mass={frame: 450, arm: 300}", "system.supports=[table]",
    f"system.connections={{{MOUNT}, {HINGE}, {PIPE}}}",
)  # fmt: skip


def recorded(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times, displacement and acceleration of the table (N,), and (N, 3, 2) motion of the masses from rest."""
    rng, n = np.random.default_rng(seed), len(M)
    time, omega = np.arange(round(RATE * DURATION)) / RATE, 2.0 * np.pi * rng.uniform(0.4, 7.0, WAVES)
    waves = 2e-3 * (10.0 / omega) * np.exp(2j * np.pi * rng.random(WAVES))
    (k1, c1), (k2, c2), (k3, c3) = TRUE.values()
    K, C = (np.array([[a + b, -b], [-b, b + c]]) / M[:, None] for a, b, c in ((k1, k2, k3), (c1, c2, c3)))
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-K, -C]])
    pushed = np.zeros((2 * n, WAVES), complex)
    pushed[n] = (k1 + 1j * omega * c1) / M[0] * waves
    flexible = (1j * omega[:, None, None] * np.eye(2 * n) - state, pushed.T[..., None])
    steady = np.linalg.solve(*flexible)[..., 0]
    turning = np.exp(1j * np.outer(time, omega))
    poles, vectors = np.linalg.eig(state)
    decays = np.exp(np.outer(time, poles)) * np.linalg.solve(vectors, -steady.sum(0).real)
    motion = (turning @ steady).real + (decays @ vectors.T).real
    table = [(turning @ (waves * (1j * omega) ** order)).real for order in range(3)]
    acceleration = -motion[:, :n] @ K.T - motion[:, n:] @ C.T
    acceleration[:, 0] += (k1 * table[0] + c1 * table[1]) / M[0]
    return time, table[0], table[2], np.stack((motion[:, :n], motion[:, n:], acceleration), 1)


def noisy(x: np.ndarray, seed: int, db: float = 40.0) -> np.ndarray:
    return x + np.sqrt(np.mean(x**2)) * 10.0 ** (-db / 20.0) * np.random.default_rng(seed).normal(size=len(x))


@pytest.fixture
def seen(tmp_path) -> dict[str, np.ndarray]:
    """The columns of seen.csv: the table, m, and the first mass, m/s^2."""
    time, table, _, motion = recorded(1)
    columns = {"t": time, "s": noisy(table, 2), "a": noisy(motion[:, 2, 0], 3)}
    pd.DataFrame(columns).to_csv(tmp_path / "seen.csv", index=False)
    return columns


@pytest.mark.slow
def test_springs_dampers_bands_and_what_comes(pinn_run: PinnRun, tmp_path, seen) -> None:
    _, table, _, motion = recorded(1)
    pd.DataFrame(seen | {"s": 1e3 * seen["s"]}).to_csv(tmp_path / "seen.csv", index=False)
    record = ("data=csv", "data.time=t", "figures=false", *SYSTEM)
    channel = "s: {sensor: displacement, support: table, unit: mm}"
    outcome = pinn_run(
        *record, f"data.path={tmp_path / 'seen.csv'}", "scheme=state_parameter", "scheme.unknown=[k_*,c_*]",
        f"data.channels={{{channel}, a: {{sensor: acceleration, dof: frame}}}}",
    ).done()  # fmt: skip
    run = outcome.record
    assert run["verdict"] == "sound", run["reasons"]
    found = outcome.parameters
    for name, (k, c) in TRUE.items():
        for kind, true in (("k", k), ("c", c)):
            row = found.loc[f"{kind}_{name}"]
            assert abs(row["estimate"] - true) < min(4.0 * row["std"], 0.05 * true), row
    with xr.open_dataset(outcome.directory / "response.nc") as response:
        for order, quantity in enumerate(("displacement", "velocity", "acceleration")):
            off = response[quantity].values - motion[:, order]
            assert np.mean(np.abs(off) < 1.96 * response[f"{quantity}_std"].values) > 0.8, quantity
        left = response["support_displacement"].values[:, 0] - table
        assert np.sqrt(np.mean(left**2)) < np.sqrt(np.mean((seen["s"] - table) ** 2))
        off = response["drift"].sel(connection="mount").values - (motion[:, 0, 0] - table)
        assert np.mean(np.abs(off) < 1.96 * response["drift_std"].sel(connection="mount").values) > 0.8
    time, table, _, motion = recorded(5)
    pd.DataFrame({"t": time, "s": 1e3 * noisy(table, 6)}).to_csv(tmp_path / "new.csv", index=False)
    outcome = pinn_run(
        *record, f"data.path={tmp_path / 'new.csv'}", "scheme=predict", f"model={outcome.directory}",
        f"data.channels={{{channel}}}",
    ).done()  # fmt: skip
    with xr.open_dataset(outcome.directory / "response.nc") as response:
        for order, quantity in enumerate(("displacement", "velocity")):
            off = response[quantity].values - motion[:, order]
            assert np.sqrt(np.mean(off**2)) < 0.02 * np.sqrt(np.mean(motion[:, order] ** 2))
            assert np.mean(np.abs(off) < 1.96 * response[f"{quantity}_std"].values) > 0.8, quantity


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["data.acceleration={arm: a}"], "system.supports=table: must be one with a channel of its motion"),
        (["data.channels={s: {sensor: displacement, support: wall}}"], "data.channels.s.support=wall: must be one of"),
        (["system.supports=[table,arm]", "data.force={}"], "system.supports=arm: must be a name of its own"),
        (["system.damping={ratio: 0.02}"], "system.damping={'ratio': 0.02}: must be null with system.supports"),
        (["baseline=kalman_smoother", f"data.channels={{{S}}}"], "baseline"),
        (["scheme=state_parameter", *NO_DAMPERS, f"data.channels={{{S}}}"], "system.connections.mount.c"),
    ],
)
def test_what_cannot_be_meant(pinn_run: PinnRun, tmp_path, overrides, message) -> None:
    time = np.arange(64) / RATE
    pd.DataFrame({"t": time, "s": np.sin(time), "a": np.cos(time)}).to_csv(tmp_path / "x.csv", index=False)
    given = ["data.acceleration={arm: a}"] if "channels" in overrides[-1] else []
    pinn_run("data=csv", f"data.path={tmp_path / 'x.csv'}", "data.time=t", *SYSTEM, *given, *overrides).refused(message)


@pytest.mark.usefixtures("seen")
def test_inspect_shows_what_moves_and_keeps_its_channel(pinn_run: PinnRun, tmp_path) -> None:
    channels = "data.channels={s: {sensor: displacement, support: table}, a: {sensor: acceleration, dof: frame}}"
    given = ("data=csv", f"data.path={tmp_path / 'seen.csv'}", "data.time=t", *SYSTEM, channels, "figures=false")
    outcome = pinn_run("inspect", *given).done()
    assert "displacement of support 1" in outcome.out
    assert channels in " ".join(outcome.out.replace("\\\n", " ").split())


@pytest.mark.slow
@pytest.mark.usefixtures("seen")
def test_window_by_window_from_several_starts(pinn_run: PinnRun, tmp_path) -> None:
    """What the user says is a start beside the one that the spectra tell: whichever wins hands over."""
    outcome = pinn_run(
        "data=csv", f"data.path={tmp_path / 'seen.csv'}", "data.time=t", *SYSTEM, "figures=false", "data.window=9",
        "data.overlap=2", f"data.channels={{{S}, a: {{sensor: acceleration, dof: frame}}}}", "scheme=state_parameter",
        "scheme.unknown=[k_*,c_*]",
    ).done()  # fmt: skip
    found = outcome.parameters
    for name, (k, _) in TRUE.items():
        assert found.loc[f"k_{name}", "estimate"] == pytest.approx(k, rel=0.05)


RUB_RATE, RUB_DURATION = 200.0, 12.0
RUBS = (
    "data=csv", "data.time=t", "figures=false", "system=structure", "system.dofs=[mass]", "system.supports=[base]",
    "scheme=state_parameter", "scheme.unknown=missing",
    "data.channels={b: {sensor: displacement, support: base}, x: {sensor: displacement, dof: mass}}",
)  # fmt: skip

RUB_K, RUB_C, RUB_WAVES = 1150.0, 2.0, 12
# Steps of the search for the end of a swing or of sticking, and how far it looks at once, s.
LOOK, AHEAD = 1e-3, 0.25


def rubbing(time: np.ndarray, seed: int, mass: float, friction: float) -> tuple[np.ndarray, np.ndarray]:
    """Displacement of the base, some mm of 1 to 5 Hz, and of the mass, each (N,), m: Coulomb's friction to the ground.

    The base moves the mass by a spring `K` and a damper `C`. It begins where it is held.
    """
    rng = np.random.default_rng(seed)
    frequency = rng.uniform(1.0, 5.0, RUB_WAVES)
    omega, phase = 2.0 * np.pi * frequency, np.exp(2j * np.pi * rng.random(RUB_WAVES))
    waves = 3e-3 * np.sqrt(2.0 / RUB_WAVES) * 2.5 / frequency * phase
    flexible = RUB_K + 1j * omega * RUB_C
    steady_waves, roots = waves * flexible / (flexible - mass * omega**2), np.roots([mass, RUB_C, RUB_K])
    out, place, begin = np.zeros(len(time)), 0.0, float(time[0])

    def moved(t: np.ndarray, size: np.ndarray, order: int = 0) -> np.ndarray:
        return (np.exp(1j * np.multiply.outer(t, omega)) @ (size * (1j * omega) ** order)).real

    def pull(t: np.ndarray) -> np.ndarray:
        return RUB_K * (moved(t, waves) - place) + RUB_C * moved(t, waves, 1)

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
            held = side * friction / RUB_K
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
    rng, time = np.random.default_rng(seed + 1000), np.arange(round(RUB_RATE * RUB_DURATION)) / RUB_RATE
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
        *RUBS, f"data.path={written(tmp_path / 'seen.csv', seed, mass, friction)}", f"system.mass={{mass: {mass}}}",
        f"system.connections={{spring: {{between: [base, mass], law: linear, c: null, k: null}}, {contact}}}",
    ).done()  # fmt: skip
    run = outcome.record
    assert (run["verdict"], run["reasons"]) == ("sound", [])
    found = outcome.parameters
    for name, true, known in (("F_c_rub", friction, 0.02), ("k_spring", RUB_K, 0.005), ("c_spring", RUB_C, damper)):
        row = found.loc[name]
        assert abs(row["estimate"] - true) < 4.0 * row["std"], row
        assert row["std"] < known * true, row
    free = pd.read_csv(outcome.directory / "free_run.csv").set_index(["against", "group", "quantity"])
    assert free.loc[("estimate", "all", "displacement"), "fitness_percent"] > 95.0
