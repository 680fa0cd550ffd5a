"""The examples of docs/extending.md: in an installed package of somebody's own, as they stand, they run."""

import importlib
import importlib.metadata
import re
import runpy
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pandas as pd
import pytest
from calls import register

ROOT = Path(__file__).parents[1]
PAGE, TUTORIAL = (ROOT / "docs" / name for name in ("extending.md", "tutorial.md"))
FENCED = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
PLACE = re.compile(r"# (\S+\.(?:py|yaml|toml))\n")
# Files that an example brings along, one in each folder.
FOLDERS = ("conf", "my_pinn")


def examples():
    """Heading to its files, {path: text}, and its commands."""
    found = {}
    for section in PAGE.read_text(encoding="utf-8").split("\n## ")[1:]:
        blocks = FENCED.findall(section)
        files = {PLACE.match(text)[1]: text for language, text in blocks if language}
        commands = [line for language, text in blocks if not language for line in text.splitlines()]
        found[section.partition("\n")[0]] = files, commands
    return found


EXAMPLES = examples()
(PYPROJECT,) = [text for language, text in FENCED.findall(PAGE.read_text(encoding="utf-8")) if language == "toml"]
ENTRY_POINTS = tomllib.loads(PYPROJECT)["project"]["entry-points"]["pinn_cli.plugins"]


def write_package(folder):
    """The page's package: every example's files and its pyproject.toml."""
    for files in (*(files for files, _ in EXAMPLES.values()), {"pyproject.toml": PYPROJECT}):
        for name, text in files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8")


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """The package's folder, in which a test is; Python knows of it what `pip install -e` would tell."""
    folder, known = tmp_path / "my_pinn", set(sys.modules)
    write_package(folder)
    register(folder, "my_pinn", "\n".join(f"{name} = {place}" for name, place in ENTRY_POINTS.items()))
    monkeypatch.syspath_prepend(folder)
    yield folder
    for name in [name for name in set(sys.modules) - known if name.partition(".")[0] == "my_pinn"]:
        del sys.modules[name]
    importlib.invalidate_caches()


@pytest.fixture
def example(installed, pinn_run):
    """Run an example's only command."""

    def call(heading):
        (command,) = EXAMPLES[heading][1]
        return pinn_run("--config-dir", str(installed / "conf"), *shlex.split(command)[1:], "figures=false").done()

    return call


def make(*scripts):
    """What scripts make, in the folder of the test."""
    for text in scripts:
        Path("script.py").write_text(text, encoding="utf-8")
        runpy.run_path("script.py")


def fitness(outcome, estimator="pinn"):
    """Of the displacement of all DOFs, by the printed formula."""
    rows = pd.read_csv(outcome.directory / "fitness.csv").set_index(["estimator", "group", "quantity"])
    return rows.loc[(estimator, "all", "displacement"), "fitness_percent"]


@pytest.mark.parametrize("heading", EXAMPLES)
def test_an_example_is_one_file_and_one_yaml(heading):
    files, commands = EXAMPLES[heading]
    new = [name for name in files if "/" in name]
    assert sorted(name.partition("/")[0] for name in new) == list(FOLDERS)
    assert not any((ROOT / name).exists() for name in new)
    assert len(commands) == 1


@pytest.mark.parametrize("heading", EXAMPLES)
def test_an_example_is_refused_where_its_package_is_not_installed(heading, tmp_path, pinn_run):
    write_package(tmp_path / "my_pinn")
    (command,) = EXAMPLES[heading][1]
    pinn_run("--config-dir", "my_pinn/conf", *shlex.split(command)[1:]).refused("_target_=my_pinn.", "entry point")


@pytest.mark.slow
def test_pip_registers_the_package(tmp_path):
    write_package(tmp_path / "my_pinn")
    place = tmp_path / "place"
    command = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*command, "--target", str(place), str(tmp_path / "my_pinn")], check=True, cwd=tmp_path)
    (found,) = importlib.metadata.distributions(path=[str(place)])
    assert {point.name: point.value for point in found.entry_points} == ENTRY_POINTS


def test_a_law_of_a_connection(example):
    parameters = example("A law of a connection").parameters
    assert parameters.loc["strength_1", "estimate"] == pytest.approx(0.5, rel=0.05)
    assert parameters.loc["strength_2", "estimate"] == pytest.approx(0.5, rel=0.05)


def test_a_law_is_one_of_a_structure_s_connections_too(installed, pinn_run):
    connections = "{a: {between: [ground, x], law: softening_spring, width: 0.02, c: 1, k: 15, strength: 0.5}}"
    outcome = pinn_run(
        "system=structure", "system.dofs=[x]", "system.mass=10", f"system.connections={connections}", "figures=false",
        "scheme.unobserved=[]", "simulation.duration=10", "simulation.samples=256", "excitation.band=[0.2,1]",
    ).done()  # fmt: skip
    assert "strength_a" in outcome.parameters.index


def test_a_network(example):
    assert fitness(example("A network")) > 99.0


@pytest.mark.slow
def test_a_file_format_of_records(example):
    """Its script turns the tutorial's record into rig.npz."""
    (tutorial,) = [text for language, text in FENCED.findall(TUTORIAL.read_text(encoding="utf-8")) if language]
    make(tutorial, EXAMPLES["A file format of records"][0]["make_npz.py"])
    parameters = example("A file format of records").parameters
    assert parameters.loc["k_1", "estimate"] == pytest.approx(40e3, rel=0.01)


def test_a_kind_of_sensor(example):
    make(EXAMPLES["A kind of sensor"][0]["make_tower.py"])
    outcome = example("A kind of sensor")
    parameters = outcome.parameters
    assert parameters.loc["k_1", "estimate"] == pytest.approx(40e3, rel=0.01)
    assert parameters.loc["k_2", "estimate"] == pytest.approx(30e3, rel=0.01)
    sensors = pd.read_csv(outcome.directory / "residuals.csv").set_index("channel")
    assert sensors.loc["displacement of sensor tilt", "free_run_nmse_percent"] < 1.0


def test_a_sensor_of_one_s_own_says_by_itself_what_it_feels(installed, pinn_run):
    make(EXAMPLES["A kind of sensor"][0]["make_tower.py"])
    pinn_run("--config-dir", str(installed / "conf"), "data=tower", "data.channels.tilt.dof=1").refused(
        "data.channels.tilt.dof"
    )


@pytest.mark.slow  # a file format as well
def test_a_force_that_moves(example):
    make(EXAMPLES["A force that moves"][0]["make_bridge.py"])
    outcome = example("A force that moves")
    assert outcome.parameters.loc["k_pier", "estimate"] == pytest.approx(2e6, rel=0.03)
    assert outcome.record["verdict"] == "sound"


def test_a_scheme(example):
    parameters = example("A scheme").parameters
    assert list(parameters.index) == ["k_1", "k_2", "k_3"]
    # The prescribed values are 5 to 10 % off.
    assert parameters["error_percent"].abs().max() < 2.0


def test_a_training(example):
    assert fitness(example("A training")) > 99.0


def test_an_estimator(example):
    outcome = example("An estimator")
    assert outcome.record["baseline"]["stop_reason"] == "simulated"
    # The prescribed values are 5 to 10 % off, which the network finds out from the sensors.
    assert fitness(outcome, estimator="open_loop") < 95.0 < fitness(outcome)
