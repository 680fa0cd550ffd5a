"""From a file as it lies on the disk to a command that runs as it is."""

import re
import shlex

import numpy as np
import pandas as pd
import pytest
from files_as_they_lie import FILES, MASS, RATE, SAMPLES, STIFFNESS, rig
from hydra import compose, initialize_config_module

from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.prepare import prepare_problem

WITHOUT_FORCE = ("wind.csv",)
# Those that the quick suite looks at by the command; tests/record/files reads them all.
QUICK = ("local dates.csv", "rows.csv", "struct.mat")


def proposed(out: str) -> list[str]:
    """The words of the command that is proposed, without the program's name."""
    after = out.partition("To estimate:\n")[2].partition("\n\n")[0]
    text = " ".join(line for line in after.splitlines() if not line.startswith("/"))
    return shlex.split(text.replace("\\ ", " "))[1:]


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in FILES]
)
def test_a_file_is_looked_at_and_the_command_gets_as_far_as_a_problem(name, pinn_run, tmp_path):
    FILES[name](tmp_path / name)
    outcome = pinn_run("inspect", name, "figures=false").done()
    assert outcome.err == ""
    assert outcome.out.startswith(f"{SAMPLES} samples from 0 to 11.98 s, at 50 Hz")
    channels = pd.read_csv(outcome.directory / "inspect.csv").set_index("channel")["rms"]
    _, force, acceleration = rig()
    for dof, values in enumerate(acceleration.T, start=1):
        assert channels[f"acceleration of DOF {dof}"] == pytest.approx(values.std(), rel=1e-4)
    if name not in WITHOUT_FORCE:
        assert channels["force of DOF 1"] == pytest.approx(force.std(), rel=1e-4)
    words = [re.sub(r"^(?=[\w.]+=\{)", "++", word) for word in proposed(outcome.out)]
    assert "figures=false" in words
    with initialize_config_module("pinn_cli.conf", version_base="1.3"):
        config = RunConfig.read(compose("config", overrides=words), tmp_path)
    problem = prepare_problem(config).problem.first
    assert problem.record.time[-1] == pytest.approx((SAMPLES - 1) / RATE)
    names = {parameter.name for parameter in problem.uncertain}
    assert names >= {"k_1", "k_2", "c_1", "c_2"} | (set() if name in WITHOUT_FORCE else {"m_1", "m_2"})


@pytest.mark.slow
@pytest.mark.parametrize("name", [*QUICK, *WITHOUT_FORCE, "shaker.uff"])
def test_the_command_runs_as_it_is(name, pinn_run, tmp_path):
    FILES[name](tmp_path / name)
    outcome = pinn_run(*proposed(pinn_run("inspect", name, "figures=false").out)).done()
    if name in WITHOUT_FORCE:
        return
    found = pd.read_csv(outcome.directory / "parameters.csv").set_index("parameter")["estimate"]
    np.testing.assert_allclose(found[["m_1", "m_2"]], MASS, rtol=0.05)
    np.testing.assert_allclose(found[["k_1", "k_2"]], STIFFNESS, rtol=0.05)


def test_what_nobody_measured_is_said_plainly(pinn_run, tmp_path):
    FILES["wind.csv"](tmp_path / "wind.csv")
    out = pinn_run("inspect", "wind.csv", "figures=false").out
    words = proposed(out)
    assert "data.force={1: null, 2: null}" in words
    assert "system.m=1" in words
    assert 'data.channels={S1_g: {sensor: acceleration, column: "S1 [g]", dof: 1, offset: unknown}}' in words
    assert 'data.acceleration={2: "S2 [g]"}' in words
    assert 'data.displacement={2: "L2 [mm]"}' in words
    assert "stiffness and damping come out per kg" in " ".join(out.split())


def test_what_the_command_says_is_kept(pinn_run, tmp_path):
    FILES["wind.csv"](tmp_path / "wind.csv")
    folder = tmp_path / "mine" / "experiment"
    folder.mkdir(parents=True)
    (folder / "rig.yaml").write_text(
        "# @package _global_\ndefaults:\n  - override /system: structure\n  - override /data: csv\n  - _self_\n"
        "system: {dofs: [low, top], mass: 2.0, connections: {a: {between: [ground, low], law: linear},\n"
        "  b: {between: [low, top], law: linear}}}\n"
        "data: {path: wind.csv, acceleration: {low: 'S1 [g]', top: 'S2 [g]'}}\n"
    )
    outcome = pinn_run("inspect", "--config-dir", "mine", "experiment=rig", "figures=false").done()
    assert proposed(outcome.out) == [
        "--config-dir", "mine", "experiment=rig", "figures=false", "data.force={1: null, 2: null}",
        "scheme=state_parameter", "scheme.unknown=missing",
    ]  # fmt: skip


def test_an_offset_replaces_what_was_typed_of_its_sensor(pinn_run, tmp_path):
    FILES["wind.csv"](tmp_path / "wind.csv")
    typed = 'data.acceleration={1: "S1 [g]", 2: "S2 [g]"}'
    words = proposed(pinn_run("inspect", "wind.csv", typed, "system=linear", "system.ndof=2", "figures=false").out)
    assert typed not in words
    assert [word for word in words if "S1" in word] == [
        'data.channels={S1_g: {sensor: acceleration, column: "S1 [g]", dof: 1, offset: unknown}}'
    ]
    assert 'data.acceleration={2: "S2 [g]"}' in words


def test_a_file_is_known_by_what_is_in_it(pinn_run, tmp_path):
    FILES["struct.mat"](tmp_path / "record.mat")
    (tmp_path / "record.mat").rename(tmp_path / "record.bin")
    FILES["tabs.dat"](tmp_path / "record")
    for name in ("record.bin", "record"):
        outcome = pinn_run("inspect", name, "figures=false")
        assert outcome.out.startswith(f"{SAMPLES} samples"), outcome.err
    assert "data.time=Chronos" in proposed(outcome.out)


def test_a_rate_is_enough_beside_a_column_of_dates(pinn_run, tmp_path):
    FILES["local dates.csv"](tmp_path / "rig.csv")
    text = (tmp_path / "rig.csv").read_text().replace("59:56.500", "yesterday")
    (tmp_path / "rig.csv").write_text(text)
    assert "line 77" in pinn_run("inspect", "rig.csv", "figures=false").err
    assert pinn_run("inspect", "rig.csv", "data.sampling_rate=50", "figures=false").status == 0
