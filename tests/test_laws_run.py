"""Laws, springs and dampings that nobody knows, wrong bounds, unknowns of zero: from other code's records to files."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from ambient_records import white_below
from calls import PinnRun
from independent_records import IndependentRecord, frame_record, storey_record
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from scipy.linalg import eigh
from storeys import K, chain_matrix, record, system, under_waves, written

from pinn_cli.model.file import stored_model
from pinn_cli.report.fitness import fitness_percent

RATE = 100.0
MASS, STIFFNESS, DAMPING, HARDENING = 1500.0, 6.0e5, 900.0, 4.0e9
SPRING = (
    "data=csv", "data.time=t", "system=structure", "system.dofs=[x]", f"system.mass={{x: {MASS}}}",
    "scheme=state_parameter", "scheme.unknown=missing",
    "data.channels={f: {sensor: force, dof: x}, a: {sensor: acceleration, dof: x}}",
)  # fmt: skip


def law(e: np.ndarray) -> np.ndarray:
    """Stiffer one way than the other, and hardening."""
    return STIFFNESS * e + 1.0e7 * e**2 + HARDENING * e**3


def integrated(
    rates: Callable[[float, np.ndarray], np.ndarray], time: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray]:
    """States (N, size) from rest, and their rates."""
    solved = solve_ivp(rates, time[[0, -1]], np.zeros(size), t_eval=time, max_step=0.2 / RATE, rtol=1e-8, atol=1e-11)
    states = solved.y.T
    return states, np.array([rates(t, state) for t, state in zip(time, states, strict=True)])


def write_noisy(
    path: Path, rng: np.random.Generator, time: np.ndarray, columns: dict[str, np.ndarray], snr_db: float
) -> Path:
    noisy = {name: x + 10.0 ** (-snr_db / 20.0) * x.std() * rng.standard_normal(len(x)) for name, x in columns.items()}
    pd.DataFrame({"t": time} | noisy).to_csv(path, index=False)
    return path


def spring_written(path: Path) -> Path:
    rng, time = np.random.default_rng(11), np.arange(round(RATE * 30.0)) / RATE
    force = 2000.0 * white_below(12.0, RATE, time.shape, rng)
    pushed = make_interp_spline(time, force, 5)

    def rates(t: float, state: np.ndarray) -> np.ndarray:
        return np.array([state[1], (pushed(t) - law(state[0]) - DAMPING * state[1]) / MASS])

    states, moved = integrated(rates, time, 2)
    return write_noisy(path, rng, time, {"f": force, "x": states[:, 0], "a": moved[:, 1]}, 30.0)


@pytest.mark.slow
def test_a_law_that_nobody_knows_lies_in_its_band(pinn_run: PinnRun, tmp_path: Path):
    path = spring_written(tmp_path / "spring.csv")
    joined = "{spring: {between: [ground, x], law: spline, elongation: 0.03}}"
    seen = "data.channels.x={sensor: displacement, dof: x}"
    outcome = pinn_run(*SPRING, seen, f"system.connections={joined}", f"data.path={path}", "hydra.run.dir=run").done()
    curves = pd.read_csv(outcome.directory / "restoring.csv").set_index("over")
    assert set(curves["connection"]) == {"spring"}
    assert outcome.record["verdict"] == "sound"
    over, speed = curves.loc["elongation"], curves.loc["speed"]
    apart = np.abs(over["force"] - law(over["at"].to_numpy()))
    assert np.mean(apart <= 1.96 * over["std"]) > 0.9
    assert over["std"].median() < 0.02 * over["force"].abs().max()
    assert np.all(np.abs(speed["force"] - DAMPING * speed["at"]) <= 4.0 * speed["std"] + 1e-9)
    assert (outcome.directory / "figures" / "restoring.png").is_file()
    # What was found does under the same force what it did, by its own knots, until the load cell's noise parts them.
    record = "data=csv", "data.time=t", "data.channels={f: {sensor: force, dof: x}}", f"data.path={path}"
    again = pinn_run("model=run", "scheme=predict", *record, "figures=false", "hydra.run.dir=again").done()
    estimated, predicted = (xr.load_dataset(done.directory / "response.nc") for done in (outcome, again))
    apart = (predicted["displacement"] - estimated["displacement"])[:200]
    assert abs(apart).max() < 0.1 * abs(estimated["displacement"][:200]).max()


STOP_MASS, TRUE = (3.8, 3.9), {"c_wall": 3.8, "k_wall": 2300.0, "c_stop": 4.2, "k_stop": 1600.0, "k_g_stop": 1800.0}
STOP = (
    "data=csv", "data.time=t", "figures=false", "system=structure", "system.dofs=[a, b]",
    f"system.mass={{a: {STOP_MASS[0]}, b: {STOP_MASS[1]}}}", "scheme=state_parameter", "scheme.unknown=missing",
    "data.channels={f: {sensor: force, dof: b}, a: {sensor: acceleration, dof: a}, b: {sensor: acceleration, dof: b}}",
)  # fmt: skip


def stop_written(path: Path, sides: str, gap: float) -> Path:
    rng, time = np.random.default_rng(7), np.arange(round(RATE * 20.0)) / RATE
    force = 60.0 * white_below(12.0, RATE, time.shape, rng)
    pushed = make_interp_spline(time, force, 5)

    def rates(t: float, state: np.ndarray) -> np.ndarray:
        (x, y), (v, w) = state[:2], state[2:]
        e = y - x
        contact = max(e - gap, 0.0) * (sides != "negative") - max(-e - gap, 0.0) * (sides != "positive")
        wall = TRUE["c_wall"] * v + TRUE["k_wall"] * x
        stop = TRUE["c_stop"] * (w - v) + TRUE["k_stop"] * e + TRUE["k_g_stop"] * contact
        return np.array([v, w, (stop - wall) / STOP_MASS[0], (pushed(t) - stop) / STOP_MASS[1]])

    _, moved = integrated(rates, time, 4)
    return write_noisy(path, rng, time, {"f": force, "a": moved[:, 2], "b": moved[:, 3]}, 40.0)


@pytest.mark.slow
@pytest.mark.parametrize(("sides", "gap"), [("both", 0.03), ("negative", 0.05)])
def test_stiffness_and_gap_of_a_contact_are_identified(pinn_run: PinnRun, tmp_path: Path, sides: str, gap: float):
    joined = f"{{wall: {{between: [ground, a], law: linear}}, stop: {{between: [a, b], law: gap, sides: {sides}}}}}"
    path = stop_written(tmp_path / "stop.csv", sides, gap)
    outcome = pinn_run(*STOP, f"system.connections={joined}", f"data.path={path}", "hydra.run.dir=run").done()
    table = outcome.parameters
    for name, true in (TRUE | {"gap_stop": gap}).items():
        estimate, std = table.loc[name, ["estimate", "std"]]
        assert abs(estimate - true) < 4.0 * std, name
        assert std < 0.02 * true, name


@pytest.mark.slow
def test_knots_come_together_where_a_gap_closes(pinn_run: PinnRun, tmp_path: Path):
    path, gap = stop_written(tmp_path / "stop.csv", "both", 0.03), 0.03
    wall, stop = "wall: {between: [ground, a], law: linear}", "{between: [a, b], law: spline, elongation: 0.2}"
    joined = f"system.connections={{{wall}, stop: {stop}}}"
    outcome = pinn_run(*STOP, joined, f"data.path={path}", "hydra.run.dir=run").done()
    knots = np.array(stored_model(outcome.directory).structure.laws[1].knots["elongation"])
    even = 0.4 / (len(knots) - 1)
    for corner in (-gap, gap):
        assert np.diff(knots)[np.argmin(abs((knots[1:] + knots[:-1]) / 2.0 - corner))] < 0.5 * even
    curves = pd.read_csv(outcome.directory / "restoring.csv").set_index("over")
    over = curves.loc["elongation"]
    e = over["at"].to_numpy()
    contact = np.maximum(e - gap, 0.0) - np.maximum(-e - gap, 0.0)
    true = TRUE["k_stop"] * e + TRUE["k_g_stop"] * contact
    assert np.mean(np.abs(over["force"] - true) <= 1.96 * over["std"]) > 0.9
    assert np.sqrt(np.mean((over["force"] - true) ** 2)) < 0.005 * np.abs(true).max()


BOUNDED = ("system=duffing", "system.ndof=1", "system.m=12", "system.c=10", "system.k=4e3")


@pytest.mark.slow
@pytest.mark.parametrize(("softens", "seed"), [(0.0, 1), (0.0, 2), (0.01, 1), (0.01, 2)])
def test_a_bound_that_the_spring_contradicts_is_told_and_the_model_is_that_of_the_table(
    pinn_run: PinnRun, tmp_path: Path, softens: float, seed: int
) -> None:
    """With a linear spring the unknown cubic one is about zero, and the run is sound."""
    size = storey_record((0.3, 12.0), 2000, 100.0, 3.0, 40.0, seed, mass=12.0).truth.displacement.std()
    made = storey_record((0.3, 12.0), 2000, 100.0, 3.0, 40.0, seed, mass=12.0, kappa=-softens / size**2).record
    columns = {"t": made.time, "f": made.force[:, 0], "a": made.acceleration[:, 0]}
    pd.DataFrame(columns).to_csv(tmp_path / "rig.csv", index=False)
    data = (
        "data=csv", f"data.path={tmp_path}/rig.csv", "data.time=t", "data.force={1: f}", "data.acceleration={1: a}",
        "figures=false", "threads=1",
    )  # fmt: skip
    unknown = "scheme.unknown=[k_1,c_1,kappa_1]"
    pinn_run(*BOUNDED, *data, "scheme=state_parameter", unknown, "hydra.run.dir=first").done()
    run = json.loads(Path("first/run.json").read_text())
    assert run["verdict"] == ("questionable" if softens else "sound")
    assert any("kappa_1 is held at its bound, 0" in reason for reason in run["reasons"]) == bool(softens)
    pinn_run("model=first", *data, "hydra.run.dir=again").done()
    table, used = (pd.read_csv(f"{name}/parameters.csv").set_index("parameter") for name in ("first", "again"))
    assert np.all(np.abs(used["prescribed"] - table["estimate"]) < 0.02 * table["std"])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_offset_and_quadratic_springs_of_zero_leave_a_good_run_sound(pinn_run, tmp_path, seed):
    written(record(seed, duration=20.0, snr_db=40.0).record, tmp_path / "rig.csv")
    channels = ", ".join(f"a{i}: {{sensor: acceleration, dof: {i}, offset: unknown}}" for i in (1, 2, 3))
    done = pinn_run(
        "system=polynomial", *system()[1:], "system.nonlinearity.orders=[2]", "data=csv",
        f"data.path={tmp_path}/rig.csv",
        f"data.channels={{f: {{sensor: force, dof: 3}}, {channels}}}", "data.time=t", "scheme=state_parameter",
        "scheme.unknown=[k_*,k_2_*]", "figures=false", "threads=1",
    ).done()  # fmt: skip
    found = done.parameters
    zero = found[found.index.str.startswith(("offset", "k_2_"))]
    zero = zero[zero["start"].notna() & ~zero.index.isin(["k_1", "k_2", "k_3"])]
    assert len(zero) == 6
    assert np.all(np.abs(zero["estimate"]) < 4.0 * zero["std"])
    np.testing.assert_allclose(found.loc[["k_1", "k_2", "k_3"], "estimate"], K, rtol=2e-3)
    assert done.record["verdict"] == "sound"


STOREY = 2000.0
SPRINGS, ZETA = np.array([1.5e6, 1.4e6, 1.2e6]), np.array([0.02, 0.015, 0.025])


def chain_of_ratios(path: Path, seed: int) -> Path:
    """A record of accelerometers on three storeys under a force on the roof, 40 dB."""
    rng, stiffness = np.random.default_rng(seed), chain_matrix(SPRINGS)
    squares, shapes = eigh(stiffness, STOREY * np.eye(3))
    damping = STOREY**2 * shapes @ np.diag(2.0 * ZETA * np.sqrt(squares)) @ shapes.T
    waves = 2.0 * np.pi * rng.uniform(0.3, 15.0, 40), rng.uniform(0.0, 2.0 * np.pi, 40)
    time = np.arange(round(20.0 * RATE)) / RATE
    acting = np.array([0.0, 0.0, 80.0])
    _, _, a, force = under_waves(np.full(3, STOREY), (damping, stiffness), acting, waves, time, RATE)
    return write_noisy(path, rng, time, {"f": 80.0 * force, **{f"a{i + 1}": a[:, i] for i in range(3)}}, 40.0)


RECORD = (
    "data=csv", "data.time=t", "data.force={3: f}", "data.acceleration={1: a1, 2: a2, 3: a3}", "system=linear",
    "system.ndof=3", f"system.m={STOREY}", "scheme=state_parameter", "scheme.unknown=missing", "figures=false",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_stiffnesses_and_ratios_are_found_together(pinn_run: PinnRun, tmp_path, seed):
    path = chain_of_ratios(tmp_path / "record.csv", seed)
    outcome = pinn_run(*RECORD, f"data.path={path}", "system.damping={ratio: [null, null, null]}").done()
    found = outcome.parameters
    true = {f"k_{i + 1}": k for i, k in enumerate(SPRINGS)} | {f"zeta_{i + 1}": zeta for i, zeta in enumerate(ZETA)}
    for name, value in true.items():
        row = found.loc[name]
        assert abs(row["estimate"] / value - 1.0) < (1e-3 if name.startswith("k") else 0.03), name
        assert abs(row["estimate"] - value) < 4.0 * row["std"] < 0.2 * value, name
    modes = pd.read_csv(outcome.directory / "modes.csv")
    np.testing.assert_allclose(modes["damping_ratio"], [found.loc[f"zeta_{i}", "estimate"] for i in (1, 2, 3)])
    assert outcome.record["verdict"] == "sound", outcome.out


@pytest.mark.slow
def test_dampers_between_the_masses_are_doubted(pinn_run: PinnRun, tmp_path):
    path = chain_of_ratios(tmp_path / "record.csv", 2)
    outcome = pinn_run(*RECORD, f"data.path={path}", "scheme.unknown=[k_*, c_*]")
    ran = outcome.record
    assert ran["verdict"] != "sound", outcome.out
    assert any("the damping ratio of mode" in reason for reason in ran["reasons"])


@pytest.mark.slow
@pytest.mark.parametrize("windows", [(), ("data.window=10", "data.overlap=2")], ids=["whole", "windows"])
def test_without_a_word_each_mode_in_the_band_has_a_ratio(pinn_run: PinnRun, tmp_path, windows):
    path = chain_of_ratios(tmp_path / "record.csv", 3)
    outcome = pinn_run(*RECORD, f"data.path={path}", "scheme.unknown=[k_*]", *windows).done()
    assert "nothing is said of damping" in outcome.out + outcome.err
    found = outcome.parameters
    np.testing.assert_allclose(
        [found.loc[f"zeta_{i}", "estimate"] for i in (1, 2, 3)], ZETA, rtol=0.05 if windows else 0.03
    )


WITHIN_95 = 1.959964
UNKNOWN = ("scheme=state_parameter", "scheme.unknown=[k_*,kappa_1]")


def frame_written(made: IndependentRecord, folder: Path) -> tuple[str, ...]:
    """The record as a file, and the settings that name its columns and the structure."""
    record, s = made.record, made.structure
    columns = {"t": record.time, "f": record.force[:, 2], **{f"a{i + 1}": record.acceleration[:, i] for i in range(3)}}
    pd.DataFrame(columns).to_csv(folder / "frame.csv", index=False)
    structure = [f"system.{kind}={getattr(s, kind).tolist()}" for kind in ("m", "c", "k", "kappa")]
    return (
        "system=duffing", "system.ndof=3", *structure, "data=csv", f"data.path={folder / 'frame.csv'}", "data.time=t",
        "data.force={3: f}", "data.acceleration={1: a1, 2: a2, 3: a3}", "figures=false",
    )  # fmt: skip


@pytest.mark.slow
def test_the_motion_of_a_known_frame(pinn_run: PinnRun, tmp_path: Path) -> None:
    made = frame_record()
    done = pinn_run(*frame_written(made, tmp_path)).done()
    with xr.open_dataset(done.directory / "response.nc") as response:
        for quantity, least in (("displacement", 98.5), ("velocity", 98.5), ("acceleration", 97.0)):
            true, found = getattr(made.truth, quantity), response[quantity].values
            assert np.mean(fitness_percent(found, true)) >= least, quantity
            inside = np.abs(found - true) < WITHIN_95 * response[f"{quantity}_std"].values
            assert 0.85 < inside.mean() < 0.995, quantity
    assert done.record["verdict"] == "sound", done.record["reasons"]


@pytest.mark.slow
def test_unknown_springs_from_the_default_start(pinn_run: PinnRun, tmp_path: Path) -> None:
    made = frame_record()
    nothing = ("system.k=null", "system.kappa=[null,0,0]")
    done = pinn_run(*frame_written(made, tmp_path), *UNKNOWN, *nothing).done()
    table, s = done.parameters, made.structure
    for i in range(3):
        row = table.loc[f"k_{i + 1}"]
        assert row["estimate"] == pytest.approx(s.k[i], rel=0.01)
        assert row["estimate"] == pytest.approx(s.k[i], abs=4.0 * row["std"])
    assert table.loc["kappa_1", "estimate"] == pytest.approx(s.kappa[0], rel=0.1)
    assert done.record["verdict"] == "sound", done.record["reasons"]


@pytest.mark.parametrize("factor", [0.01, 100.0])
@pytest.mark.slow
def test_a_start_a_hundred_times_off_ends_at_the_truth(pinn_run: PinnRun, tmp_path: Path, factor: float) -> None:
    made = frame_record(rate=100.0, duration=8.0)
    start = ", ".join(f"k_{i + 1}: {factor * k:.0f}" for i, k in enumerate(made.structure.k))
    unknown = ("scheme=state_parameter", "scheme.unknown=[k_*]", f"scheme.initial={{{start}}}")
    done = pinn_run(*frame_written(made, tmp_path), *unknown).done()
    np.testing.assert_allclose(done.parameters.loc[["k_1", "k_2", "k_3"], "estimate"], made.structure.k, rtol=0.01)


RIG = Path(__file__).parents[1].parent / "shared" / "tools" / "rig.py"
# One to eight storeys; stiffnesses are unknown and prescribed up to a decade off in the second experiment.
SEEDS = ("6", "8")


def tool(*arguments: str) -> str:
    return subprocess.run([sys.executable, str(RIG), *arguments], check=True, capture_output=True, text=True).stdout


@pytest.mark.slow
@pytest.mark.skipif(not RIG.is_file(), reason=f"there is no {RIG.name} beside the checkout")
@pytest.mark.parametrize("experiment", ["rig", "rig_unknown"])
@pytest.mark.parametrize("seed", SEEDS)
def test_a_random_structure_is_estimated_right_and_called_sound(pinn_run, tmp_path, seed, experiment):
    tool("make", str(tmp_path / "rig"), "--seed", seed)
    done = pinn_run("--config-dir", str(tmp_path / "rig"), f"experiment={experiment}", "figures=false").done()
    score = json.loads(tool("score", str(tmp_path / "rig"), str(done.directory)))
    assert score["verdict"] == "sound"
    assert score["inside_u"] >= 0.7
    assert score["k_error_percent"] < 10.0
    assert score["k_error_std"] < 5.0
