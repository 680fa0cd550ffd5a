"""Every command of README.md and docs/ is accepted: composed, validated, and posed up to the first step of training."""

import re
import shlex
from pathlib import Path

import pytest
from calls import Compose
from documented_commands import (
    EVERY,
    FOLLOWED,
    LOOKS,
    MODAL,
    RUNS,
    first_job,
    missing_package,
    shortened,
    write_files,
    write_model_run,
)

from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.inspecting import Inspected
from pinn_cli.cli.options import read_options
from pinn_cli.cli.prepare import check_windows
from pinn_cli.inspection.inspection import inspect_record
from pinn_cli.inspection.modes import ModalRecord
from pinn_cli.record.windows import GrowingWindows
from pinn_cli.scheme.modal_problem import modal_problem
from pinn_cli.training.estimate import RunContext
from pinn_cli.training.evidence import Evidence
from pinn_cli.training.function_space import training as over_all_weights
from pinn_cli.training.gradient import training as gradient_training

# A second of processor time and more: test_examples.py and test_finite_element_run.py run them.
SIMULATED_LONG = re.compile(r"experiment=examples/")


class TrainingBeginsError(Exception):
    """Nothing has refused the command."""


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files and the configuration that the pages speak of."""
    folder = tmp_path_factory.mktemp("files")
    write_files(folder)
    write_model_run(folder)
    return folder


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch, files: Path) -> Path:
    monkeypatch.chdir(files)
    return files


@pytest.fixture(autouse=True)
def no_work(monkeypatch: pytest.MonkeyPatch) -> None:
    def begins(*arguments: object, **settings: object) -> None:
        raise TrainingBeginsError

    monkeypatch.setattr(over_all_weights, "train", begins)
    monkeypatch.setattr(gradient_training, "train", begins)
    monkeypatch.setattr(Evidence, "train", begins)


@pytest.mark.parametrize(
    "line", [pytest.param(line, marks=pytest.mark.slow if SIMULATED_LONG.search(line) else ()) for line in RUNS]
)
def test_a_documented_run_gets_as_far_as_training(composed: Compose, line: str, rig: Path) -> None:
    if package := missing_package(line):
        pytest.skip(f"{package} is not installed")
    arguments = [argument for argument in shlex.split(line, comments=True)[1:] if argument != "--multirun"]
    while "--config-dir" in arguments:
        place = arguments.index("--config-dir")
        arguments[place : place + 2] = [f"hydra.searchpath=[file://{rig / arguments[place + 1]}]"]
    config = RunConfig.read(composed(*first_job(shortened(arguments))), rig)
    true, prescribed = config.model_error.structures(config.structure)
    record = config.observe(config.source.measure(true).record)
    modes = config.modes
    posed = config.scheme.pose(prescribed, [record]) if modes is None else modal_problem(modes, prescribed, [record])
    if config.scheme.predicts:  # nothing is trained
        assert config.estimator.solve(posed, RunContext()).peaks
        return
    with pytest.raises(TrainingBeginsError):
        config.estimator.solve(posed, RunContext())


@pytest.mark.parametrize("line", LOOKS)
def test_a_documented_look_is_had(composed: Compose, line: str, rig: Path) -> None:
    overrides = read_options(shlex.split(line)[1:]).overrides
    (looked_at,) = Inspected.read(composed(*first_job(overrides)), rig, "inspect")
    assert inspect_record(looked_at.signals, looked_at.time, looked_at.said, looked_at.frequencies).command


@pytest.mark.parametrize("line", MODAL)
def test_documented_modes_are_found(composed: Compose, line: str, rig: Path) -> None:
    overrides = read_options(shlex.split(line)[1:]).overrides
    for looked_at in Inspected.read(composed(*first_job(overrides)), rig, "modes"):
        assert ModalRecord.of(looked_at.signals, looked_at.time).modes


@pytest.mark.parametrize("line", FOLLOWED)
def test_a_documented_record_can_be_followed(composed: Compose, line: str, rig: Path) -> None:
    config = RunConfig.read(composed(*first_job(shlex.split(line)[2:])), rig, follows=True)
    check_windows(config)
    assert isinstance(config.source.windows, GrowingWindows)


def test_there_are_commands_to_test() -> None:
    assert len(RUNS) > 25
    others = [line for line in EVERY if line not in (*RUNS, *LOOKS, *MODAL, *FOLLOWED)]
    of_runs = r"pinn-run (--help|(resume|collect)=\S+|population \S+)( +#.*)?$"
    assert all(re.search(of_runs, line) for line in others), others
