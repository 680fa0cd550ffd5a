"""Every command of README.md and docs/ is accepted, posed up to the first step of training, and runs to its end."""

import re
import shlex
import shutil
from pathlib import Path

import pandas as pd
import pytest
from calls import Compose, PinnRun
from documented_commands import (
    EVERY,
    FOLLOWED,
    GALLERY,
    LOOKS,
    MODAL,
    RIG,
    RUNS,
    first_job,
    missing_package,
    shortened,
    write_files,
    write_model_run,
)

from pinn_cli.cli.composing import compose_config
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

# A second of processor time and more: the examples below and test_finite_element_run.py run them.
SIMULATED_LONG = re.compile(r"experiment=examples/")


class TrainingBeginsError(Exception):
    """Nothing has refused the command."""


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files, the configuration and the run that the pages speak of."""
    folder = tmp_path_factory.mktemp("files")
    write_files(folder)
    write_model_run(folder)
    (folder / "arriving").mkdir()
    shutil.copy(RIG, folder / "arriving" / "rig.csv")
    return folder


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch, files: Path) -> Path:
    monkeypatch.chdir(files)
    return files


@pytest.fixture
def no_work(monkeypatch: pytest.MonkeyPatch) -> None:
    def begins(*arguments: object, **settings: object) -> None:
        raise TrainingBeginsError

    monkeypatch.setattr(over_all_weights, "train", begins)
    monkeypatch.setattr(gradient_training, "train", begins)
    monkeypatch.setattr(Evidence, "train", begins)


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize(
    "line", [pytest.param(line, marks=pytest.mark.slow if SIMULATED_LONG.search(line) else ()) for line in RUNS]
)
def test_a_documented_run_gets_as_far_as_training(line: str, rig: Path) -> None:
    if package := missing_package(line):
        pytest.skip(f"{package} is not installed")
    options = read_options(shlex.split(line, comments=True)[1:])
    config = RunConfig.read(compose_config(first_job(shortened(options.overrides)), options.config_dir), rig)
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


# They take hours, and are posed alone.
HOURS = re.compile(r"paper_training")
# Where the jobs of a sweep go, and who chooses them: a job is a run like any other.
OF_SWEEPS = re.compile(r"hydra/launcher|hydra/sweeper|hydra\.launcher\.|hydra\.sweeper\.")


@pytest.mark.slow
@pytest.mark.parametrize(
    "line", [line for line in (*RUNS, *LOOKS, *MODAL, *FOLLOWED) if line not in GALLERY and not HOURS.search(line)]
)
def test_a_documented_command_runs(line: str, files: Path, pinn_run: PinnRun) -> None:
    if package := missing_package(line):
        pytest.skip(f"{package} is not installed")
    arguments = [argument for argument in shlex.split(line, comments=True)[1:] if argument != "--multirun"]
    options = [argument for argument in arguments[:1] if argument in ("inspect", "modes", "follow")]
    if "--config-dir" in arguments:
        place = arguments.index("--config-dir")
        options += arguments[place : place + 2]
        del arguments[place : place + 2]
    # What is no override is a file to look at.
    options += [argument for argument in arguments[1:] if options and "=" not in argument]
    own = arguments if options else shortened(arguments)
    overrides = [argument for argument in own if argument not in options and not OF_SWEEPS.search(argument)]
    overrides += ["follow.until_idle=0.2", "follow.poll=0.1"] if options == ["follow"] else []
    # A search is of what its experiment runs.
    overrides = [re.sub(r",search/\w+|^experiment=search/\w+$", "", override) for override in overrides]
    shutil.copytree(files, Path.cwd(), dirs_exist_ok=True)
    # Of a map on the command line the keys are added anyway.
    job = [override.removeprefix("++") for override in first_job([override for override in overrides if override])]
    for made in (o.removeprefix("hydra.run.dir=") for o in job if o.startswith("hydra.run.dir=")):
        shutil.rmtree(made, ignore_errors=True)  # for other commands it is there already
    outcome = pinn_run(*options, *job).done()
    assert outcome.directory.is_dir()


# Per cent by which each unknown parameter may be off: some four standard deviations.
EXAMPLES = {
    "frame_with_brace": {"k_storey_1": 0.7, "k_brace": 0.7, "kappa_storey_1": 1.7},
    "tuned_mass_damper": {"k_spring": 0.3, "c_damper": 1.6},
    "shear_building_earthquake": {"k_storey_1": 1.6, "k_storey_2": 2.1, "k_storey_3": 0.7},
    "frame_with_hysteretic_brace": {},
    "ambient_vibration": {},
}
# Where forces are not measured, slow drift is not told.
DISPLACEMENT = {"ambient_vibration": 90.0}
# What the roof of a frame does, other frames do too.
SEVERAL = ("shear_building_earthquake",)


@pytest.mark.slow
@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_finds_what_it_asks_for(pinn_run: PinnRun, example: str) -> None:
    outcome = pinn_run(f"experiment=examples/{example}", "figures=false").done()
    parameters = outcome.parameters
    for name, percent in EXAMPLES[example].items():
        assert parameters.loc[name, "error_percent"] < percent
    fitness = pd.read_csv(outcome.directory / "fitness.csv").set_index(["group", "quantity"])["fitness_percent"]
    assert fitness["unobserved", "displacement"] > DISPLACEMENT.get(example, 97.0)
    verdict = outcome.record
    if example not in SEVERAL:
        assert verdict["verdict"] == "sound"
        return
    assert verdict["verdict"] == "questionable"
    (reason,) = verdict["reasons"]
    assert reason.startswith("another structure explains the record as well")
