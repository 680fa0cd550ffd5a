"""The examples of docs/extending.md: added to the package as they stand, they run."""

import importlib
import json
import re
import runpy
import shlex
import sys
from pathlib import Path

import pandas as pd
import pytest

ROOT = Path(__file__).parents[1]
PAGE, TUTORIAL = (ROOT / "docs" / name for name in ("extending.md", "tutorial.md"))
FENCED = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
PLACE = re.compile(r"# (\S+\.(?:py|yaml))\n")
# Files that an example may bring along, one in each folder.
FOLDERS = ("pinn_cli", "conf")


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


@pytest.fixture
def extended(tmp_path, monkeypatch):
    """A folder with the files of every example; the package looks for modules there too while a test runs."""
    known = set(sys.modules)
    for files, _ in EXAMPLES.values():
        for name, text in files.items():
            place, package = tmp_path / "extended" / name, Path(name).parent.as_posix().replace("/", ".")
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_text(text, encoding="utf-8")
            if package.startswith("pinn_cli."):
                searched = importlib.import_module(package).__path__
                monkeypatch.setattr(sys.modules[package], "__path__", [*searched, str(place.parent)])
    importlib.invalidate_caches()
    yield tmp_path / "extended"
    for name in [name for name in set(sys.modules) - known if str(tmp_path) in str(sys.modules[name])]:
        del sys.modules[name]


@pytest.fixture
def example(extended, pinn_run):
    """Run an example's only command; returns the run's directory."""

    def call(heading):
        (command,) = EXAMPLES[heading][1]
        arguments = shlex.split(command)[1:]
        outcome = pinn_run("--config-dir", str(extended / "conf"), *arguments, "figures=false")
        assert outcome.status == 0, outcome.err
        return outcome.directory

    return call


@pytest.fixture
def rig(tmp_path, monkeypatch):
    """rig.npz, made of what the tutorial makes."""
    monkeypatch.chdir(tmp_path)
    (tutorial,) = [text for language, text in FENCED.findall(TUTORIAL.read_text(encoding="utf-8")) if language]
    for text in (tutorial, EXAMPLES["A file format of records"][0]["make_npz.py"]):
        Path("script.py").write_text(text, encoding="utf-8")
        runpy.run_path("script.py")


def fitness(directory, estimator="pinn"):
    """Of the displacement of all DOFs, by the printed formula."""
    rows = pd.read_csv(directory / "fitness.csv").set_index(["estimator", "group", "quantity"])
    return rows.loc[(estimator, "all", "displacement"), "fitness_percent"]


@pytest.mark.parametrize("heading", EXAMPLES)
def test_an_example_is_one_file_and_one_yaml(heading):
    files, commands = EXAMPLES[heading]
    new = [name for name in files if "/" in name]
    assert sorted(name.partition("/")[0] for name in new) == sorted(FOLDERS)
    assert not any((ROOT / name).exists() for name in new)
    assert len(commands) == 1


def test_a_law_of_a_connection(example):
    directory = example("A law of a connection")
    parameters = pd.read_csv(directory / "parameters.csv").set_index("parameter")
    assert parameters.loc["friction_1", "estimate"] == pytest.approx(0.5, rel=0.05)
    assert parameters.loc["friction_2", "estimate"] == pytest.approx(0.5, rel=0.05)


def test_a_network(example):
    assert fitness(example("A network")) > 99.0


def test_a_file_format_of_records(example, rig):
    directory = example("A file format of records")
    parameters = pd.read_csv(directory / "parameters.csv").set_index("parameter")
    assert parameters.loc["k_1", "estimate"] == pytest.approx(40e3, rel=0.01)


def test_a_scheme(example):
    directory = example("A scheme")
    parameters = pd.read_csv(directory / "parameters.csv").set_index("parameter")
    assert list(parameters.index) == ["k_1", "k_2", "k_3"]
    # The prescribed values are 5 to 10 % off.
    assert parameters["error_percent"].abs().max() < 2.0


def test_a_training(example):
    assert fitness(example("A training")) > 99.0


def test_an_estimator(example):
    directory = example("An estimator")
    assert json.loads((directory / "run.json").read_text())["baseline"]["stop_reason"] == "simulated"
    # The prescribed values are 5 to 10 % off, which the network finds out from the sensors.
    assert fitness(directory, estimator="open_loop") < 95.0 < fitness(directory)
