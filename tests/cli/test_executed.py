"""A configuration executes nothing: wherever it says to, a marker file stays unwritten and one line says why."""

import subprocess
from pathlib import Path

import pytest
from calls import SMALL, Outcome, PinnRun
from interrupted_runs import contents
from omegaconf import OmegaConf

from pinn_cli.report import run_record

MARKER = "marker"
# A class of an installed package that starts the program that it is given, and a module that acts when it is imported.
STARTER = "torch.distributed.elastic.multiprocessing.subprocess_handler.subprocess_handler.SubprocessHandler"
IMPORTED = "acting_when_imported.Anything"


@pytest.fixture
def marker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What must not appear; the module and the package of configurations that would write it lie on the path."""
    place, marker = tmp_path / "importable", tmp_path / MARKER
    package = place / "acting_package"
    package.mkdir(parents=True)
    act = f"import pathlib\npathlib.Path({str(marker)!r}).touch()\n"
    (place / "acting_when_imported.py").write_text(act + "class Anything:\n    pass\n")
    (package / "__init__.py").write_text(act)
    monkeypatch.syspath_prepend(place)
    return marker


def own_file(marker: Path, name: str, text: str) -> None:
    """A file of a user's own, `own/GROUP/mine.yaml`."""
    (file := marker.parent / "own" / f"{name}.yaml").parent.mkdir(parents=True)
    file.write_text(text)


OWN = ("--config-dir", "own")


def refused(outcome: Outcome, marker: Path, told: str) -> None:
    """Exit status 2, one line that says what, and nothing was executed or left behind."""
    outcome.refused(told)
    assert not marker.exists()
    assert not (marker.parent / "outputs").exists()


@pytest.mark.parametrize("place", ["network", "data", "tracking"])
def test_a_target_on_the_command_line(pinn_run: PinnRun, marker: Path, place: str) -> None:
    refused(pinn_run(f"++{place}._target_={IMPORTED}"), marker, f"{place}._target_={IMPORTED}")
    given = f"{{entrypoint: touch, args: ['{marker}'], env: {{}}, stdout: null, stderr: null, local_rank_id: 0}}"
    refused(pinn_run(f"++network={given}", f"++network._target_={STARTER}"), marker, "network._target_=")


@pytest.mark.parametrize("name", ["network", "baseline", "noise", "data.force", "system.nonlinearity"])
def test_a_target_within_a_node(pinn_run: PinnRun, marker: Path, name: str) -> None:
    refused(pinn_run(f"++{name}.deep={{a: [{{_target_: {IMPORTED}}}]}}"), marker, f"{name}.deep.a[0]._target_")


@pytest.mark.parametrize("group", ["network", "baseline", "tracking", "hydra/launcher", "hydra/sweeper"])
def test_a_target_in_a_file_of_one_s_own(pinn_run: PinnRun, marker: Path, group: str) -> None:
    own_file(marker, f"{group}/mine", f"_target_: {IMPORTED}\n")
    sweep = ("--multirun", "seed=0,1") if group.startswith("hydra") else ()
    outcome = pinn_run(*OWN, f"{group}=mine", *sweep)
    refused(outcome, marker, f"{group.replace('/', '.')}._target_={IMPORTED}")


def test_a_target_in_a_job_of_a_sweep(pinn_run: PinnRun, marker: Path) -> None:
    own_file(marker, "network/mine", f"_target_: {IMPORTED}\n")
    outcome = pinn_run(*OWN, "--multirun", "network=spline,mine")
    assert (outcome.status, f"network._target_={IMPORTED}" in outcome.err, marker.exists()) == (2, True, False)


def test_a_target_that_is_put_together(pinn_run: PinnRun, marker: Path) -> None:
    outcome = pinn_run("+case={a: acting_when_imported.Anything}", "network._target_=${case.a}")
    refused(outcome, marker, "network._target_=${case.a}")
    made = "'${oc.create:{_target_:acting_when_imported.Anything}}'"
    refused(pinn_run(f"++network.depth={made}"), marker, "network.depth=${oc.create:{_target_:acting")


def test_a_directory_that_is_resumed(pinn_run: PinnRun, marker: Path) -> None:
    assert pinn_run(*SMALL, task=lambda config: None).status == 0
    stored = next((marker.parent / "outputs").rglob(".hydra")) / "config.yaml"
    content = stored.read_text()
    for place in ("network", "system", "tracking"):
        config = OmegaConf.create(content)
        OmegaConf.update(config, f"{place}._target_", IMPORTED, force_add=True)
        OmegaConf.save(config, stored)
        before = contents(marker.parent)
        pinn_run(f"resume={stored.parents[1]}").refused(f"{place}._target_={IMPORTED}")
        assert contents(marker.parent) == before


HYDRA_NODES = {
    "callback": ("callbacks: {x: {_target_: acting_when_imported.Anything}}", "hydra.callbacks.x._target_"),
    "callback within": (
        "callbacks: {sweep: {_target_: acting_when_imported.Anything, x: {_target_: os.system}}}",
        "hydra.callbacks.sweep",
    ),
    "callback put together": ("callbacks: {x: '${network}'}", "hydra.callbacks.x"),
    "factory": ("job_logging: {handlers: {x: {(): acting_when_imported.Anything}}}", "hydra.job_logging={"),
    "class": ("hydra_logging: {formatters: {simple: {class: acting_when_imported.Anything}}}", "hydra.hydra_logging={"),
    "looked up": (
        "job_logging: {formatters: {brief: {format: 'ext://acting_when_imported.Anything'}}}",
        "job_logging={",
    ),
    "logging put together": ("job_logging: '${network}'", "hydra.job_logging=${network}"),
    "file that is emptied": (
        "job_logging: {handlers: {console: {class: logging.FileHandler, filename: victim, mode: w}}}",
        "hydra.job_logging={",
    ),
    "log named elsewhere": ("job: {name: ../../victim}", "hydra.job.name=../../victim"),
    "folder elsewhere": ("output_subdir: ../..", "hydra.output_subdir=../.."),
    "environment": ("job: {env_set: {GIT_CONFIG_COUNT: '1'}}", "hydra.job.env_set.GIT_CONFIG_COUNT=1"),
    "library path": ("job: {env_set: {LD_PRELOAD: evil.so}}", "hydra.job.env_set.LD_PRELOAD=evil.so"),
    "overrides": ("overrides: {hydra: ['hydra.searchpath=[pkg://acting_package]']}", "hydra.overrides="),
}


@pytest.mark.parametrize(("content", "told"), HYDRA_NODES.values(), ids=HYDRA_NODES.keys())
def test_the_hydra_node_of_an_experiment(pinn_run: PinnRun, marker: Path, content: str, told: str) -> None:
    own_file(marker, "experiment/theirs", f"# @package _global_\nhydra:\n  {content}\n")
    victim = marker.parent / "victim"
    victim.write_text("mine")
    # A single run and a sweep are started in different ways, and showing a configuration sets up logs, too.
    more = (("--cfg", "job"), ("--multirun", "seed=0,1"), ())[len(content) % 3]
    refused(pinn_run(*OWN, "experiment=theirs", *more), marker, told)
    assert victim.read_text() == "mine"


def test_a_search_path_that_is_imported(pinn_run: PinnRun, marker: Path) -> None:
    folder = "pkg://acting_package"
    for plus, *more in (("",), ("+", "--multirun", "seed=0,1"), ("++", "--cfg", "job")):
        refused(pinn_run(f"{plus}hydra.searchpath=[{folder}]", *more), marker, f"hydra.searchpath={folder}")
    target = "hydra_plugins.pinn_run.sweepers.BasicSweeper"
    own_file(marker, "hydra/sweeper/mine", f"_target_: {target}\nparams: {{hydra.searchpath: '[{folder}]'}}\n")
    assert pinn_run(*OWN, "hydra/sweeper=mine", "--multirun", "seed=0,1").status == 2
    assert not marker.exists()


@pytest.mark.parametrize("option", ["--experimental-rerun", "--config-path", "--config-name", "--info"])
def test_options_of_hydra_that_load_code_are_none(pinn_run: PinnRun, marker: Path, option: str) -> None:
    refused(pinn_run(option, "pkg://acting_package"), marker, f"option={option}")


SHELL = {
    "commands": ("setup: ['touch {marker}']", "hydra.launcher.setup"),
    "option with a line break": ('partition: "short\\ntouch {marker}"', "hydra.launcher.partition"),
    "any option": ("additional_parameters: {{wrap: 'touch {marker}'}}", "hydra.launcher.additional_parameters.wrap"),
    "pickles elsewhere": ("submitit_folder: '{marker}'", "hydra.launcher.submitit_folder"),
}


@pytest.mark.parametrize(("content", "told"), SHELL.values(), ids=SHELL.keys())
def test_what_reaches_a_shell_is_typed(pinn_run: PinnRun, marker: Path, content: str, told: str) -> None:
    text = f"# @package _global_\nhydra:\n  launcher:\n    {content.format(marker=marker)}\n"
    own_file(marker, "experiment/theirs", text)
    command = (*OWN, "experiment=theirs", "hydra/launcher=slurm", "--multirun", "seed=0,1")
    refused(pinn_run(*command), marker, told)
    shown = pinn_run("hydra/launcher=slurm", "hydra.launcher.setup=[module load python]", "--cfg", "hydra")
    assert "module load python" in shown.out, shown.err


def test_a_foreign_ray_is_typed(pinn_run: PinnRun, marker: Path) -> None:
    address = "{launcher: {ray: {init: {address: ray.example.org:6379}}}}"
    own_file(marker, "experiment/theirs", f"# @package _global_\nhydra: {address}\n")
    command = (*OWN, "experiment=theirs", "hydra/launcher=ray_cluster", "--multirun", "seed=0,1")
    refused(pinn_run(*command), marker, "hydra.launcher.ray.init.address=ray.example.org:6379")


def test_what_a_user_sets_of_hydra_still_works(pinn_run: PinnRun) -> None:
    for allowed in (
        ("hydra.job.env_set={OMP_NUM_THREADS: 1}", "hydra.job.env_copy=[HOME]", "hydra.verbose=[pinn_cli.runs]"),
        ("hydra/job_logging=stdout", "hydra/hydra_logging=none"),
    ):
        assert pinn_run(*allowed, task=lambda config: None).err == ""


def test_a_repository_s_configuration_runs_no_program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`git` is asked which commit runs, with none of its variables and none of the repository's programs."""
    checkout, marker, script = tmp_path / "checkout", tmp_path / MARKER, tmp_path / "script"
    script.write_text(f"#!/bin/sh\ntouch {marker}\n")
    script.chmod(0o755)
    place = checkout / "pinn_cli" / "report"
    place.mkdir(parents=True)
    (place / "file").write_text("a")
    git = ["git", "-C", str(checkout), "-c", "user.name=a", "-c", "user.email=a@example.org"]
    for arguments in (["init", "-q"], ["add", "."], ["commit", "-qm", "a"], ["config", "core.fsmonitor", str(script)]):
        subprocess.run([*git, *arguments], check=True)
    variables = {"GIT_CONFIG_COUNT": "1", "GIT_CONFIG_KEY_0": "core.fsmonitor", "GIT_CONFIG_VALUE_0": str(script)}
    variables |= {"GIT_DIR": str(tmp_path), "GIT_TRACE": str(marker)}
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(run_record, "__file__", str(place / "run_record.py"))
    assert len(run_record.git_revision.__wrapped__()) == 40  # what is kept of it is of another checkout
    assert not marker.exists()
