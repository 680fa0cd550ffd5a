"""Whole runs on finite-element models."""

import re

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from beams import beam, beam_part, deflection, response
from calls import PinnRun
from documented_commands import MY_STRUCTURE, blocks
from omegaconf import OmegaConf
from scipy.io import mmwrite

from pinn_cli.cli.composing import compose_config
from pinn_cli.cli.source import read_structure
from pinn_cli.record.simulation import simulate
from pinn_cli.system.finite_elements import build_finite_elements
from pinn_cli.system.modes import modes_of

DOFS = {"tip": deflection(10), "a": deflection(5), "b": deflection(8), "p": deflection(3)}
STOP = "{stop: {between: [ground, tip], law: duffing, c: 0, k: 0, kappa: 4e4}}"
SMALL = (
    "system=matrices", "system.path=beam.npz", f"system.dofs={{{', '.join(f'{n}: {d}' for n, d in DOFS.items())}}}",
    "system.modes=2", "system.damping_ratio=0.02", "simulation.duration=2", "simulation.samples=257",
    "excitation.band=[1,30]", "excitation.rms=5", "excitation.dofs=[tip]", "noise.snr_db=40", "figures=false",
    "scheme.unobserved=[tip,p]",
)  # fmt: skip
IDENTIFY = ("scheme=state_parameter", "scheme.unknown=[kappa_stop]", "scheme.parameter_uncertainty=0")


def random_force(random: np.random.Generator, time: np.ndarray, low: float, high: float, waves: int = 60) -> np.ndarray:
    """Sinusoids between two frequencies, Hz."""
    frequencies, phases = random.uniform(low, high, waves), random.uniform(0.0, 2.0 * np.pi, waves)
    return np.sin(2.0 * np.pi * np.outer(time, frequencies) + phases).sum(1)


def write_noisy(random: np.random.Generator, columns: dict[str, np.ndarray], exact: tuple[str, ...] = ("t",)) -> None:
    """The columns as a file, with noise of 40 dB on all that are not exact."""
    table = pd.DataFrame(columns)
    noise = 0.01 * random.standard_normal(table.shape) * table.std().to_numpy()
    noise[:, table.columns.isin(exact)] = 0.0
    (table + noise).to_csv("beam.csv", index=False)


@pytest.fixture
def in_folder_with_a_beam(pinn_run: PinnRun) -> PinnRun:
    M, K = beam(10)
    np.savez("beam.npz", M=M.toarray(), K=K.toarray())
    return pinn_run


def strict_fitness(directory) -> pd.Series:
    """Of the displacements, by DOF, %."""
    with xr.open_dataset(directory / "response.nc") as found:
        names = found["dof_name"].values
        estimate, true = (found[name].values for name in ("displacement", "displacement_true"))
    return pd.Series(100 * (1 - np.linalg.norm(estimate - true, axis=0) / np.linalg.norm(true, axis=0)), names)


@pytest.mark.slow
def test_a_cubic_stop_at_the_tip_is_found(in_folder_with_a_beam: PinnRun):
    pair = "system.drifts={bend: [a, tip]}"
    outcome = in_folder_with_a_beam(*SMALL, *IDENTIFY, f"system.connections={STOP}", pair).done()
    parameters = outcome.parameters
    assert parameters["estimate"]["kappa_stop"] == pytest.approx(4e4, rel=0.03)
    drifts = pd.read_csv(outcome.directory / "drift.csv").set_index("connection")
    assert drifts.index.tolist() == ["stop", "bend"]
    assert (drifts["error_percent"] < 2.0).all()
    with xr.open_dataset(outcome.directory / "response.nc") as found:
        u, bend = found["displacement"].values, found.sel(connection="bend")
        np.testing.assert_allclose(bend["drift"], u[:, 0] - u[:, 1], atol=1e-9 * np.abs(u).max())
        missed = np.abs(bend["drift"] - bend["drift_true"]) / bend["drift_std"]
        assert np.mean(missed < 1.96) > 0.85
        assert np.isnan(bend["connection_force"]).all()
    fitness = strict_fitness(outcome.directory)
    assert (fitness > 99.0).all(), fitness


@pytest.mark.slow
def test_a_model_without_connections_has_no_drifts_to_draw(in_folder_with_a_beam: PinnRun):
    outcome = in_folder_with_a_beam(
        *SMALL, "simulation.samples=129", "scheme.parameter_uncertainty=0", "figures=true"
    ).done()
    assert (outcome.directory / "run.json").is_file()
    assert pd.read_csv(outcome.directory / "drift.csv").empty


@pytest.mark.slow
def test_a_record_that_begins_in_motion_with_modes_above_its_band(in_folder_with_a_beam: PinnRun):
    """No sensor tells those, and they balanced each other at both ends: accelerations were wrong by 100 times."""
    rate, finer, before, random = 128.0, 16, 2.0, np.random.default_rng(3)
    moments = np.arange(-before, 2.0, 1.0 / (finer * rate))
    force = random_force(random, moments, 1.0, 30.0)
    motion = response(*beam(10), 0.02, (DOFS["b"], force), 1.0 / (finer * rate))
    kept = slice(int(before * finer * rate), None, finer)
    u, _, a = (x[kept][:, [dof - 1 for dof in DOFS.values()]] for x in motion)
    write_noisy(random, {"t": moments[kept], "f": force[kept], "tip": a[:, 0], "a": a[:, 1]})
    outcome = in_folder_with_a_beam(
        *SMALL[:3], "system.modes=7", "system.damping_ratio=0.02", "data=csv", "data.path=beam.csv",
        "data.force={b: f}", "data.acceleration={tip: tip, a: a}", "scheme.parameter_uncertainty=0", "figures=false",
    ).done()  # fmt: skip
    with xr.open_dataset(outcome.directory / "response.nc") as found:
        for name, true in (("displacement", u), ("acceleration", a)):
            missed = np.abs(found[name] - true)
            assert np.sqrt(np.mean(missed.values**2, axis=0) / np.mean(true**2, axis=0)).max() < 0.05
            assert np.mean(missed < 1.96 * found[f"{name}_std"]) > 0.85
    assert (pd.read_csv(outcome.directory / "residuals.csv")["free_run_nmse_percent"].dropna() < 1.0).all()


@pytest.mark.slow
def test_a_mass_on_a_dof_that_the_model_does_not_have_is_named(in_folder_with_a_beam: PinnRun):
    rate, finer, random = 128.0, 16, np.random.default_rng(5)
    moments = np.arange(0.0, 6.0, 1.0 / (finer * rate))
    force = random_force(random, moments, 1.0, 30.0)
    M, K = beam(10)
    M[DOFS["a"] - 1, DOFS["a"] - 1] += 0.2
    _, _, acceleration = response(M, K, 0.02, (DOFS["b"], force), 1.0 / (finer * rate))
    a = acceleration[::finer][:, [DOFS[name] - 1 for name in ("tip", "a", "b")]]
    write_noisy(random, {"t": moments[::finer], "f": force[::finer], **dict(zip(("tip", "a", "b"), a.T, strict=True))})
    outcome = in_folder_with_a_beam(
        *SMALL[:3], "system.modes=6", "system.damping_ratio=0.02", "data=csv", "data.path=beam.csv",
        "data.force={b: f}", "data.acceleration={tip: tip, a: a, b: b}", "scheme.parameter_uncertainty=0",
        "figures=false",
    ).done()  # fmt: skip
    told = outcome.record
    assert told["verdict"] != "sound"
    (by, std) = re.search(
        r"the mass of DOF a is another one, by (\S+) \+- (\S+) kg", " ".join(told["reasons"])
    ).groups()
    assert float(by) == pytest.approx(0.2, rel=0.25), (by, std)


@pytest.mark.parametrize(
    "scheme",
    [
        ["scheme=state_parameter", "scheme.parameter_uncertainty=0"],
        pytest.param(
            ["scheme=bayesian", "posterior.chains=2", "posterior.warmup=200", "posterior.draws=200"],
            marks=pytest.mark.slow,
        ),
    ],
    ids=["estimated", "sampled"],
)
def test_the_stiffness_of_parts_is_updated(in_folder_with_a_beam: PinnRun, scheme: list[str]):
    for name, own in (("root", range(5)), ("end", range(5, 10))):
        mmwrite(f"{name}.mtx", beam_part(10, own))
    outcome = in_folder_with_a_beam(
        *SMALL, *scheme, "scheme.initial_motion=rest",
        "system.factors={root: {file: root.mtx, value: 0.8}, end: {file: end.mtx, value: 1.2}}",
    ).done()  # fmt: skip
    parameters = outcome.parameters
    assert parameters.index.tolist() == ["factor_root", "factor_end"]
    assert parameters["start"].tolist() == [1.0, 1.0]
    np.testing.assert_allclose(parameters["estimate"], [0.8, 1.2], rtol=0.02)
    z = (parameters["estimate"] - parameters["true"]) / parameters["std"]
    assert (z.abs() < 3.0).all(), parameters
    assert (parameters["std"] < 0.02).all()
    first = pd.read_csv(outcome.directory / "modes.csv")
    assert len(first) == 2


def test_no_sensor_feels_the_force_of_a_part(in_folder_with_a_beam: PinnRun):
    mmwrite("root.mtx", beam_part(10, range(5)))
    columns = np.random.default_rng(0).normal(size=(64, 3))
    pd.DataFrame({"t": 0.01 * np.arange(64), **dict(zip("far", columns.T, strict=True))}).to_csv(
        "beam.csv", index=False
    )
    in_folder_with_a_beam(
        *SMALL[:5], "system.factors={root: root.mtx}", "data=csv", "data.path=beam.csv", "data.force={b: f}",
        "data.acceleration={tip: a}", "data.channels={r: {sensor: connection_force, connection: root}}",
    ).refused("data.channels.r.connection=root", "a connection: mode_1, mode_2")  # fmt: skip


@pytest.mark.slow
def test_parts_far_off_in_a_record_of_the_whole_model(pinn_run: PinnRun):
    """The first coordinates leave out more than the sensors' noise; every mode of the beam is in the record."""
    factors, sensed = (0.75, 1.25), {"tip": deflection(10), "a": deflection(4), "b": deflection(7)}
    M, K = beam(10)
    parts = [beam_part(10, own) for own in (range(4), range(4, 10))]
    np.savez("beam.npz", M=M.toarray(), K=K.toarray(), root=parts[0].toarray(), end=parts[1].toarray())
    rate, finer, random = 256.0, 64, np.random.default_rng(8)
    time = np.arange(0.0, 4.0, 1.0 / (finer * rate))
    force = random_force(random, time, 3.0, 80.0, 80) * np.minimum(4.0 * time, 1.0)
    changed = sum(f * part for f, part in zip(factors, parts, strict=True))
    motion = response(M, changed, 0.02, (sensed["b"], force), time[1])[2][::finer]
    table = pd.DataFrame({"f": force[::finer], **{name: motion[:, dof - 1] for name, dof in sensed.items()}})
    table += 10.0 ** (-50 / 20) * random.standard_normal(table.shape) * table.std().to_numpy()
    table.insert(0, "t", time[::finer])
    table.to_csv("beam.csv", index=False)
    outcome = pinn_run(
        "system=matrices", "system.path=beam.npz", "system.modes=5", "system.factors={root: null, end: null}",
        f"system.dofs={{{', '.join(f'{n}: {d}' for n, d in sensed.items())}}}",
        "data=csv", "data.path=beam.csv", "data.force={b: f}",
        "data.acceleration={tip: tip, a: a, b: b}", "scheme=state_parameter", "scheme.parameter_uncertainty=0",
        "figures=false",
    ).done()  # fmt: skip
    assert "nothing is said of damping" in outcome.out + outcome.err
    found = outcome.parameters
    true = {"factor_root": factors[0], "factor_end": factors[1]} | {f"zeta_{i}": 0.02 for i in (1, 2, 3)}
    z = {name: (found["estimate"][name] - value) / found["std"][name] for name, value in true.items()}
    assert max(map(abs, z.values())) < 3.5, z
    assert (found["std"][["factor_root", "factor_end"]] < 1e-3).all()
    assert outcome.record["verdict"] == "sound", outcome.out


def test_sensors_bend_as_those_of_the_whole_model(tmp_path, monkeypatch):
    """What modes that are left out add to a sensor is what a static force there moves."""
    monkeypatch.chdir(tmp_path)
    M, K = beam(10)
    np.savez("beam.npz", M=M.toarray(), K=K.toarray())
    config = compose_config(["system=matrices", "data=csv"])
    OmegaConf.set_struct(config, False)
    channels = {"up": {"dof": "b", "sensor": "displacement", "column": "u"}}
    config.system.merge_with({"path": "beam.npz", "dofs": DOFS, "modes": 2, "damping_ratio": 0.02})
    config.data.merge_with({"force": {"tip": "f"}, "acceleration": {"a": "a"}, "channels": channels})
    structure = read_structure(config, None)
    at = [DOFS[name] - 1 for name in ("tip", "a", "b")]
    shapes = structure.shapes.matrix[:3]
    found = shapes @ np.linalg.solve(modes_of(structure).K, shapes.T)
    np.testing.assert_allclose(found, np.linalg.inv(K.toarray())[np.ix_(at, at)], rtol=1e-6)


@pytest.mark.slow
def test_a_shaken_model_with_an_unknown_force(in_folder_with_a_beam: PinnRun):
    structure = build_finite_elements(DOFS, "beam.npz", modes=3, damping_ratio=0.03, ground="1::2")
    time, random = np.linspace(0.0, 2.0, 257), np.random.default_rng(4)
    waves = 2 * np.pi * random.uniform(1.0, 25.0, (2, 40))
    phases = random.uniform(0.0, 2 * np.pi, waves.shape)
    force, ground = (lambda t, w=w, p=p: np.sin(t[:, None] * w + p).sum(1) for w, p in zip(waves, phases, strict=True))
    moved = simulate(structure, lambda t: np.outer(force(t), [1.0, 0, 0, 0]), time, substeps=80, ground=ground)
    columns = {"t": time, "ground": ground(time), "up": moved.displacement[:, 3], **{
        name: moved.acceleration[:, i] for i, name in enumerate(DOFS)
    }}  # fmt: skip
    write_noisy(random, columns, ("t", "up"))
    outcome = in_folder_with_a_beam(
        *SMALL[:3], "system.modes=3", "system.damping_ratio=0.03", "system.ground=1::2", "data=csv",
        "data.path=beam.csv", "data.force={tip: null}", "data.acceleration={tip: tip, a: a, b: b}",
        "data.displacement={p: up}", "data.holdout=[p]", "data.ground_acceleration=ground", "figures=false",
    ).done()  # fmt: skip
    with xr.open_dataset(outcome.directory / "response.nc") as found:
        at_p, std = (found[name].values[:, 3] for name in ("displacement", "displacement_std"))
        error = found["force"].values[20:-20, 0] - force(time)[20:-20]
    # Accelerations tell little of slow forces: the band has to say how little.
    missed = at_p - moved.displacement[:, 3]
    assert np.std(missed) < 0.15 * np.std(moved.displacement[:, 3])
    assert np.mean(np.abs(missed) < 1.96 * std) > 0.8
    assert np.std(error) < 0.2 * np.std(force(time))


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["network=mlp"], "network=spline with training=gauss_newton"),
        (["simulation.hold=zero_order"], "exact with system=matrices"),
        (["system.modes=21"], "system.modes=21"),
        (["system.path=absent.npz"], "there is none at"),
        (["scheme=state_parameter", "scheme.unknown=[m_mode_1]"], "the mass of a mode is one"),
        (["scheme=bayesian", "scheme.unknown=[c_mode_1]", "posterior=conditional"], "marginal or laplace with system="),
    ],
)
def test_what_cannot_be_done_is_told_in_one_line(in_folder_with_a_beam: PinnRun, settings: list[str], said: str):
    in_folder_with_a_beam(*SMALL, *settings).refused(said)


@pytest.mark.slow
def test_the_cantilever_of_the_documentation(pinn_run: PinnRun):
    """Two hundred elements, twelve modes: the stop within 3 %, and the motion of twenty other points."""
    (script,) = blocks(MY_STRUCTURE, "python")
    exec(script, {})
    outcome = pinn_run("experiment=examples/beam_with_stop", "figures=false").done()
    assert outcome.parameters["estimate"]["kappa_stop"] == pytest.approx(4e4, rel=0.03)
    fitness = strict_fitness(outcome.directory)
    assert len(fitness) == 24
    assert (fitness > 99.0).all(), fitness


@pytest.mark.slow  # half a minute
def test_parts_are_updated_with_modes_above_the_record_s_band(pinn_run: PinnRun):
    """Solutions carried over to finer splines stuck there: sensors came out twenty times as noisy."""
    M, K = beam(20)
    np.savez("beam.npz", M=M.toarray(), K=K.toarray())
    for name, own in (("root", range(7)), ("mid", range(7, 14))):
        mmwrite(f"{name}.mtx", beam_part(20, own))
    dofs = f"{{a: {deflection(7)}, b: {deflection(13)}, tip: {deflection(20)}}}"
    outcome = pinn_run(
        "system=matrices", "system.path=beam.npz", f"system.dofs={dofs}", "system.modes=8",
        "system.damping_ratio=0.012", "simulation.duration=2.3", "simulation.samples=1001", "excitation.band=[1.3,150]",
        "excitation.rms=1", "excitation.dofs=[b]", "noise.snr_db=42", "scheme.unobserved=[b]", "seed=2",
        "scheme=state_parameter", "scheme.parameter_uncertainty=0", "scheme.initial_motion=rest", "figures=false",
        "system.factors={root: {file: root.mtx, value: 1.02}, mid: {file: mid.mtx, value: 1.07}}",
    ).done()  # fmt: skip
    parameters = outcome.parameters
    np.testing.assert_allclose(parameters["estimate"], [1.02, 1.07], rtol=2e-3)
    residuals = pd.read_csv(outcome.directory / "residuals.csv")
    accelerations = residuals[residuals["quantity"] == "acceleration"]
    noise = accelerations["signal_rms"] * 10.0 ** (-42.0 / 20.0)
    np.testing.assert_allclose(accelerations["sigma"], noise, rtol=0.3)
