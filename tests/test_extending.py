"""The examples of docs/extending.md: put into a copy of the package as they stand, they run."""

import os
import re
import shlex
import shutil
import subprocess
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


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """The package as a wheel lays it out, with the files of every example."""
    place = tmp_path_factory.mktemp("source")
    shutil.copytree(ROOT / "pinn_cli", place / "pinn_cli")  # with what is compiled of it, which saves seconds
    shutil.copytree(ROOT / "conf", place / "pinn_cli" / "conf")
    (place / "conf").symlink_to(place / "pinn_cli" / "conf")
    for files, _ in EXAMPLES.values():
        for name, text in files.items():
            if name.partition("/")[0] in FOLDERS:
                assert not (place / name).exists(), f"{name} is there already"
                (place / name).write_text(text, encoding="utf-8")
    return place


@pytest.fixture
def run(source, tmp_path):
    """Call Python with these arguments in an empty folder, with the extended package."""

    def call(*arguments):
        environment = os.environ | {"PYTHONPATH": str(source), "OMP_NUM_THREADS": "1"}
        command = [sys.executable, *arguments]
        called = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert called.returncode == 0, called.stdout + called.stderr
        return called.stdout

    return call


@pytest.fixture
def rig(run, tmp_path):
    """rig.csv, as the tutorial makes it."""
    (script,) = [text for language, text in FENCED.findall(TUTORIAL.read_text(encoding="utf-8")) if language]
    (tmp_path / "make_rig.py").write_text(script, encoding="utf-8")
    run("make_rig.py")


def pinn_run(run, heading):
    """The directory that an example's only command prints last."""
    (command,) = EXAMPLES[heading][1]
    out = run("-m", "pinn_cli.main", *shlex.split(command)[1:], "figures=false", "threads=1")
    return Path(out.splitlines()[-1])


def fitness(directory, quantity="displacement"):
    """By the printed formula, of all DOFs."""
    rows = pd.read_csv(directory / "fitness.csv").set_index(["group", "quantity"])
    return rows.loc[("all", quantity), "fitness_percent"]


@pytest.mark.parametrize("heading", EXAMPLES)
def test_an_example_is_one_file_and_one_yaml(heading):
    files, commands = EXAMPLES[heading]
    assert sorted(name.partition("/")[0] for name in files if "/" in name) == sorted(FOLDERS)
    assert len(commands) == 1


def test_a_law_of_a_connection(run):
    directory = pinn_run(run, "A law of a connection")
    parameters = pd.read_csv(directory / "parameters.csv").set_index("parameter")
    assert parameters.loc["friction_1", "estimate"] == pytest.approx(0.5, rel=0.05)
    assert parameters.loc["friction_2", "estimate"] == pytest.approx(0.5, rel=0.05)


def test_a_network(run):
    assert fitness(pinn_run(run, "A network")) > 99.0


def test_a_file_format_of_records(run, rig, tmp_path):
    (tmp_path / "make_npz.py").write_text(EXAMPLES["A file format of records"][0]["make_npz.py"], encoding="utf-8")
    run("make_npz.py")
    directory = pinn_run(run, "A file format of records")
    parameters = pd.read_csv(directory / "parameters.csv").set_index("parameter")
    assert parameters.loc["k_1", "estimate"] == pytest.approx(40e3, rel=0.01)
