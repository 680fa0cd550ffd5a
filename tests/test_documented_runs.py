"""Every command of README.md and docs/ runs to its end; a sweep's first job in its place."""

import re
import shlex
import shutil
from pathlib import Path

import pytest
from calls import PinnRun
from documented_commands import (
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

# They take hours: test_documented_commands.py poses them.
HOURS = re.compile(r"paper_training")
# Where the jobs of a sweep go, and who chooses them: a job is a run like any other.
OF_SWEEPS = re.compile(r"hydra/launcher|hydra/sweeper|hydra\.launcher\.|hydra\.sweeper\.")


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("measured")
    write_files(folder)
    shutil.copy(RIG, folder / "second.csv")
    (folder / "arriving").mkdir()
    shutil.copy(RIG, folder / "arriving" / "rig.csv")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    "line", [line for line in (*RUNS, *LOOKS, *MODAL, *FOLLOWED) if line not in GALLERY and not HOURS.search(line)]
)
def test_a_documented_command_runs(line: str, measured: Path, pinn_run: PinnRun) -> None:
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
    shutil.copytree(measured, Path.cwd(), dirs_exist_ok=True)
    if any(override.startswith("model=") for override in overrides):
        write_model_run(Path.cwd())
    # Of a map on the command line the keys are added anyway.
    job = [override.removeprefix("++") for override in first_job([override for override in overrides if override])]
    outcome = pinn_run(*options, *job).done()
    assert outcome.directory.is_dir()
