"""`--config my.yaml`, `--quiet`, `--json` and `--help GROUP`."""

import json
from pathlib import Path

import pytest
from calls import SMALL, PinnRun

from pinn_cli.cli.options import overrides_of

TEXT = """# @package _global_
defaults:
  - override /system: linear
  - override /scheme: state_parameter
  - _self_
system: {ndof: 3, k: [1.0, null, 3]}
scheme.unknown: k_2
data:
  path: my rig.csv
  force: {1: "F (1)", 2: null}
case: yes it is
strict: false
"""


def test_settings_of_a_file_are_overrides(tmp_path: Path) -> None:
    (tmp_path / "my.yaml").write_text(TEXT)
    assert overrides_of(str(tmp_path / "my.yaml"), ["system.ndof=4", "~case"]) == [
        "system=linear", "scheme=state_parameter", "system.k=[1.0,null,3]", "scheme.unknown=k_2",
        'data.path="my rig.csv"', 'data.force={1: "F (1)", 2: null}', "strict=false",
    ]  # fmt: skip


def test_a_command_with_a_file(pinn_run: PinnRun, tmp_path: Path) -> None:
    (tmp_path / "my.yaml").write_text(
        "system: linear\nsystem.ndof: 3\nnoise: {snr_db: 20.0}\nexcitation.dofs: [1, 2]\n"
    )
    text = pinn_run("--config", "my.yaml", "system.ndof=4", "--cfg", "job", "-p", "system").out
    assert "ndof: 4" in text
    assert "linear.Linear" in text
    assert pinn_run("--config", "my.yaml", "--cfg", "job", "-p", "excitation.dofs").out.split() == [
        "#", "@package", "excitation.dofs", "-", "1", "-", "2",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (None, "--config=my.yaml: must be a file of settings (YAML) that exists"),
        ("- a\n", "settings, as in"),
        ("system: {ndfo: 3}\n", "system.ndfo=3: must be one of the settings"),
        ("sytem: linear\n", "did you mean system?"),
        ("defaults: 5\n", "my.yaml, defaults=5"),
        ("a: &x [1]\nb: *x\n", "aliases are not read"),
        ("network: {_target_: os.system}\n", "network"),
    ],
)
def test_a_file_that_no_command_can_use(pinn_run: PinnRun, tmp_path: Path, text, expected) -> None:
    if text is not None:
        (tmp_path / "my.yaml").write_text(text)
    pinn_run("--config", "my.yaml").refused(expected)
    assert not (tmp_path / "outputs").exists()


def test_quiet_and_json(pinn_run: PinnRun) -> None:
    outcome = pinn_run(*SMALL, "--quiet", "figures=false", "hydra.run.dir=mine")
    assert (outcome.status, outcome.err) == (0, "")
    assert len(outcome.out.splitlines()) == 1
    assert (outcome.directory / "pinn-run.log").read_text()
    again = pinn_run(*SMALL, "--json", "figures=false", "hydra.run.dir=mine", "resume=auto")
    found = json.loads(again.out)
    assert found["directory"] == str(outcome.directory)
    run = outcome.record
    assert (found["verdict"], found["reasons"]) == (run["verdict"], run["reasons"])
    assert {row["parameter"] for row in found["parameters"]} >= {"k_1", "kappa_3"}


def test_quiet_with_a_sweep(pinn_run: PinnRun) -> None:
    """Of its jobs those alone that failed."""
    outcome = pinn_run(*SMALL, "--quiet", "--multirun", "seed=1,x", "hydra.sweep.dir=mine").refused()
    assert outcome.out == "mine\n"
    (line,) = outcome.err.splitlines()
    assert line.endswith("failed: seed=x: must be a whole number >= 0")


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--quite"], "option=--quite: must be one that pinn-run --help lists; did you mean --quiet?"),
        (["--jsn"], "did you mean --json?"),
        (["--conf=x"], "did you mean --config?"),
        (["--json", "--multirun", "seed=1,2"], "--json=given: must be left out with --multirun"),
        (["--help", "netwrk"], "did you mean network?"),
        (["--help", "network=splin"], "did you mean spline?"),
    ],
)
def test_options_that_cannot_be_used(pinn_run: PinnRun, arguments, expected) -> None:
    pinn_run(*arguments).refused(expected)


def test_help_of_a_group(pinn_run: PinnRun) -> None:
    text = pinn_run("--help", "network").out
    assert "--- network=spline" in text
    assert "--- network=mlp" in text
    assert "_target_" not in text
    one = pinn_run("--help", "data=csv").out
    assert "names_line: null" in one
    assert "path: null                 # to be given" in one
    assert "`pinn-run --help experiment=" in pinn_run("--help", "experiment").out
