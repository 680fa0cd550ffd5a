"""Exit statuses, one line per error, nothing left behind: the command line alone, with a stand-in for the task."""

import csv
import logging
import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from calls import PinnRun, register
from interrupted_runs import contents
from omegaconf import DictConfig

from pinn_cli.cli.command_line import Terminal
from pinn_cli.cli.options import OPTIONS
from pinn_cli.runs.claim import RunLog
from pinn_cli.settings.errors import DivergenceError, InputError
from pinn_cli.sweep.jobs import DEFECT, Failure, Sweep
from pinn_cli.sweep.running import Progress


def judge(config: DictConfig) -> None:
    """A task whose seed decides how it ends."""
    match config.seed:
        case 2:
            raise InputError("seed", 2, "another number")
        case 3:
            raise DivergenceError("diverged at iteration 7")
        case 4:
            raise KeyboardInterrupt
        case 5:
            raise RuntimeError("a defect")
    print("done")


def test_success_is_0_and_leaves_a_directory_of_its_own_per_run(pinn_run: PinnRun, tmp_path: Path) -> None:
    for _ in range(2):
        assert pinn_run(task=judge).status == 0
    assert len(list((tmp_path / "outputs" / "default").iterdir())) == 2
    assert all(
        (d / ".hydra").is_dir() and (d / "pinn-run.log").is_file() for d in (tmp_path / "outputs/default").iterdir()
    )


def test_unusable_input_is_2_in_one_line_and_changes_nothing(pinn_run: PinnRun, tmp_path: Path) -> None:
    pinn_run(task=judge)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("keep")
    before = contents(tmp_path), sorted(tmp_path.rglob("*"))
    for directory in ((), ("hydra.run.dir=elsewhere",), ("hydra.run.dir=mine",)):
        outcome = pinn_run("seed=2", *directory, task=judge)
        assert (outcome.status, outcome.err) == (2, "pinn-run: seed=2: must be another number\n")
    assert (contents(tmp_path), sorted(tmp_path.rglob("*"))) == before


def test_divergence_is_3_and_keeps_the_run(pinn_run: PinnRun, tmp_path: Path) -> None:
    outcome = pinn_run("seed=3", task=judge)
    assert (outcome.status, outcome.err) == (3, "pinn-run: diverged at iteration 7\n")
    (directory,) = (tmp_path / "outputs" / "default").iterdir()
    assert "diverged at iteration 7" in (directory / "pinn-run.log").read_text()


def test_interrupt_is_130_and_a_defect_keeps_its_traceback(pinn_run: PinnRun, monkeypatch) -> None:
    assert pinn_run("seed=4", task=judge).status == 130
    with pytest.raises(RuntimeError, match="a defect"):
        pinn_run("seed=5", task=judge)
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    outcome = pinn_run("seed=2", task=judge)
    assert (outcome.status, "Traceback" in outcome.err) == (2, True)


def test_a_failed_job_of_a_sweep_is_a_row_with_its_reason(pinn_run: PinnRun) -> None:
    outcome = pinn_run("--multirun", "seed=1,2,3,6", task=judge)
    assert outcome.status == 3
    assert [line[8:] for line in outcome.err.splitlines()] == [
        "seed=2  failed: seed=2: must be another number",
        "seed=3  failed: diverged at iteration 7",
    ]
    assert "\n4 jobs: 2 failed, 2 unfinished\n" in outcome.out
    rows = list(csv.DictReader((outcome.directory / "fitness.csv").open()))
    assert [row["reason"] for row in rows] == ["seed=2: must be another number", "diverged at iteration 7"]
    assert [(row["seed"], row["status"]) for row in rows] == [("2", "failed"), ("3", "failed")]


def test_a_defect_takes_no_other_job_along(pinn_run: PinnRun) -> None:
    outcome = pinn_run("--multirun", "seed=5,6", task=judge)
    assert outcome.status == 1
    assert "RuntimeError: a defect" in outcome.out
    assert "Traceback" in (outcome.directory / "seed=5" / "failure.json").read_text()
    assert "Traceback" in (outcome.directory / "seed=5" / "pinn-run.log").read_text()


def test_a_sweep_of_unusable_jobs_leaves_nothing(pinn_run: PinnRun, tmp_path: Path) -> None:
    assert pinn_run("--multirun", "seed=2", "system.ndof=3,4", task=judge).status == 2
    assert pinn_run("--multirun", "system=duffing,dufing", task=judge).status == 2
    assert list(tmp_path.iterdir()) == []


COMPOSITION_ERRORS = {
    "unknown option": (
        ["system=dufing"],
        ["system=dufing:", "duffing, friction, gap, jenkins, linear", "did you mean duffing?"],
    ),
    "unknown launcher": (["hydra/launcher=slrum"], ["hydra/launcher=slrum: must be one of basic, ", "mean slurm?"]),
    "unknown experiment": (
        ["experiment=paper/sr_6dof_snr5"],
        ["one of examples/", " paper/pe_2dof_duffing,", "did you mean paper/sr_6dof_snr50?"],
    ),
    "unknown group": (["sytem=linear"], ["sytem=linear:", "did you mean system?"]),
    "unknown setting": (["system.ndfo=3"], ["system.ndfo=3:", "system.ndof, system.m,", "did you mean system.ndof?"]),
    "setting without its group": (["ndof=3"], ["ndof=3:", "did you mean system.ndof?"]),
    "setting of another option": (["data.path=rig.csv"], ["data.path=rig.csv:", "it belongs to data=csv"]),
    "setting below a value": (["seed.x=3"], ["seed.x=3:", "did you mean seed?"]),
    "open bracket": (["system.k=[1,2"], ["system.k=[1,2:", "quotes"]),
    "home that needs quotes": (["data=csv", "data.path=~/x.csv"], ["data.path=~/x.csv:", "'data.path=\"...\"'"]),
    "quote within a word": (['case=a"b'], ['case=a"b:', "quotes"]),
    "brackets without end": ([f"system.k={'[' * 2000}{']' * 2000}"], ["system.k=[[[", "nested too deeply"]),
    "systems laid over each other": (["system=[linear,duffing]"], ["system=[linear,duffing]:", "one option"]),
    "noise of a measured record": (["data=csv", "noise.snr_db=20"], ["noise.snr_db=20:", "left out with data=csv"]),
    "sensors of a measured record": (["data=csv", "scheme.unobserved=[2]"], ["scheme.unobserved=[2]:", "data.holdout"]),
    "sweep without its option": (["hydra.mode=MULTIRUN"], ["hydra.mode=MULTIRUN:", "pinn-run --multirun"]),
    "variable that is not set": (["hydra.job.env_copy=[NOT_SET]"], ["hydra.job.env_copy=[NOT_SET]:", "'NOT_SET'"]),
    "no equals sign": (["system.ndof"], ["override=system.ndof:", "setting=value"]),
    "unquoted space": (["data=csv", "data.path=my", "rig.csv"], ["override=rig.csv:", "quotes"]),
    "list without brackets": (["system.k=1,2"], ["system.k=1,2:", "--multirun", "[1,2]"]),
    "two choices": (["+system=linear"], ["overrides=+system=linear:", "Multiple values for system"]),
    "deleting what is not there": (["~foo"], ["~foo", "does not exist"]),
    "unresolvable": (["case=${nothing}"], ["case=${nothing}:", "nothing"]),
    "unknown flag": (["--multrun"], ["--multrun:", "did you mean --multirun?"]),
    "unknown own flag": (
        ["--quite"],
        ["option=--quite: must be one that pinn-run --help lists; did you mean --quiet?"],
    ),
    "unknown flag of JSON": (["--jsn"], ["did you mean --json?"]),
    "part of a flag": (["--conf=x"], ["did you mean --config?"]),
    "help of no group": (["--help", "netwrk"], ["did you mean network?"]),
    "help of no option": (["--help", "network=splin"], ["did you mean spline?"]),
    "bad flag value": (["--cfg", "jobs"], ["jobs:", "job, hydra, all"]),
    "flags at odds": (["--cfg", "job", "--multirun"], ["--multirun --cfg"]),
    "JSON of a sweep": (["--json", "--multirun", "seed=1,2"], ["--json=given: must be left out with --multirun"]),
    "no such folder": (["--config-dir", "nowhere"], ["--config-dir=nowhere:", "folder"]),
    "no such package": (["--cfg", "job", "--package", "nothing"], ["--package=nothing:", "--cfg job"]),
    "processes": (["-m", "seed=1,2", "hydra/launcher=joblib", "hydra.launcher.n_jobs=0"], ["hydra.launcher.n_jobs=0:"]),
    "unknown callback": (["+hydra.callbacks.x={_target_: a.B}"], ["hydra.callbacks.x._target_=a.B:", "extending.md"]),
    "wrong type for Hydra": (["hydra.callbacks=5"], ["hydra.callbacks=5:"]),
}


@pytest.mark.parametrize(("arguments", "told"), COMPOSITION_ERRORS.values(), ids=COMPOSITION_ERRORS.keys())
def test_composition_errors(pinn_run: PinnRun, tmp_path: Path, arguments: list[str], told: list[str]) -> None:
    pinn_run(*arguments, task=judge).refused(*told)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("chosen", "of_job"), [("job", True), ("hydra", False), ("all", True)])
def test_settings_are_printed_as_yaml(pinn_run: PinnRun, chosen: str, of_job: bool) -> None:
    shown = yaml.safe_load(pinn_run("--cfg", chosen, "case=mine", task=judge).out)
    assert shown.get("case") == ("mine" if of_job else None)
    assert ("hydra" in shown) == (chosen != "job")
    assert chosen == "job" or shown["hydra"]["run"]["dir"].startswith("outputs/${case}/")
    resolved = pinn_run("--cfg", "all", "--resolve", "--package", "hydra.run", "case=mine", task=judge).out
    assert resolved.startswith("# @package hydra.run\ndir: outputs/mine/")


def test_a_mapping_has_keys_of_its_own_and_options_stand_anywhere(pinn_run: PinnRun) -> None:
    outcome = pinn_run("data=csv", "--cfg", "job", "data.force={1: 'f (N)'}", "--package", "data.force")
    assert (outcome.status, outcome.out) == (0, "# @package data.force\n1: f (N)\n")
    assert pinn_run("--version").out.startswith("pinn-run ")


def test_help_lists_groups_and_examples(pinn_run: PinnRun) -> None:
    text = pinn_run("--help").out
    for part in (
        "usage: pinn-run",
        "system: baber_noori, bouc_wen, duffing",
        "experiment=paper/sr_6dof",
        "--config-dir",
    ):
        assert part in text
    assert max(map(len, text.splitlines())) <= 130


def test_the_options_are_those_of_hydra(pinn_run: PinnRun) -> None:
    """Hydra has no public list of them; its help does."""
    flags = [line.partition(" : ")[0] for line in pinn_run("--hydra-help").out.splitlines() if line.startswith("--")]
    left_out = {"--config-path,-cp", "--config-name,-cn", "--experimental-rerun", "--info,-i"}
    assert sorted({",".join(names) for names in OPTIONS} | left_out) == sorted(flags)


def test_settings_are_completed_by_the_shell() -> None:
    command = [sys.executable, "-m", "pinn_cli.main", "--shell-completion"]
    installed = subprocess.run([*command, "install=bash"], capture_output=True, text=True, check=True).stdout
    assert "complete -o nospace" in installed
    asked = os.environ | {"COMP_LINE": "pinn-run system=duf", "COMP_POINT": "19"}
    found = subprocess.run([*command, "query=bash"], capture_output=True, text=True, check=True, env=asked).stdout
    assert found.split() == ["system=duffing"]


def test_a_reader_that_leaves_is_no_defect() -> None:
    command = [sys.executable, "-m", "pinn_cli.main", "--help"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.close()
    assert process.wait() == 141
    assert process.stderr.read() == b""
    process.stderr.close()


def test_nothing_slow_is_imported_before_a_run() -> None:
    modules = "pinn_cli.main, pinn_cli.sweep.running, pinn_cli.sweep.collect"
    code = f"import sys, {modules}; print(*(m for m in sys.argv[1:] if m in sys.modules))"
    slow = ["torch", "numpy", "scipy", "pandas", "xarray", "matplotlib", "mlflow", "tensorboard"]
    done = subprocess.run([sys.executable, "-c", code, *slow], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


CALLBACK = """
from hydra.experimental.callback import Callback

class Mine(Callback):
    def __init__(self, name=""):
        self.name = name

    def _note(self, **given):
        print("run" if "job_return" not in given else "ended", given["config"].seed, *filter(None, [self.name]))

    on_run_start = on_job_start = on_job_end = _note

    def on_multirun_end(self, **given):
        raise ValueError("odd")
"""


def test_callbacks_of_an_installed_package_are_called(pinn_run, tmp_path, monkeypatch):
    register(tmp_path / "own", "of_callbacks", "hydra.callbacks.mine = of_callbacks:Mine")
    (tmp_path / "own" / "of_callbacks.py").write_text(CALLBACK)
    monkeypatch.syspath_prepend(tmp_path / "own")
    given = "+hydra.callbacks.mine={_target_: of_callbacks.Mine}"
    assert pinn_run(given, "seed=1", task=judge).out.splitlines() == ["run 1", "run 1", "done", "ended 1"]
    with pytest.warns(UserWarning, match=r"Mine.on_multirun_end: ValueError\('odd'\)"):
        assert "run 7\ndone\nended 7\nrun 6\n" in pinn_run(given, "--multirun", "seed=7,6", task=judge).out
    two = "+hydra.callbacks={a: {_target_: of_callbacks.Mine, name: a}, b: {_target_: of_callbacks.Mine, name: b}}"
    assert pinn_run(two, task=judge).out.splitlines()[-2:] == ["ended 0 b", "ended 0 a"]


def test_no_control_character_reaches_a_terminal_or_a_log(
    capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    reason = "\x1b]0;title\x07\x1b[2Jå\u202e\x9b31m µ\r\nm\tN"
    Terminal().say(reason)
    Terminal().complain(reason)
    captured = capsys.readouterr()
    shown = "\\x1b]0;title\\x07\\x1b[2Jå\\u202e\\x9b31m µ"
    assert captured.out == f"{shown}\\r\nm\tN\n"
    assert captured.err == f"pinn-run: {shown} m N\n"
    log, run_log = logging.getLogger("pinn_cli.test"), RunLog()
    run_log.attach()
    log.warning("%s is gone", "\x1b[2J")
    run_log.open(tmp_path / "pinn-run.log")
    run_log.close()
    assert caplog.messages == ["\\x1b[2J is gone"]
    assert (tmp_path / "pinn-run.log").read_text().endswith("\\x1b[2J is gone\n")
    log.warning("\x1b")  # what a process logs afterwards is its own
    assert caplog.messages[-1] == "\x1b"
    progress = Progress(Sweep(tmp_path, (), {"seed=0": ("seed=0",)}, is_search=False), 0.0)
    Failure(DEFECT, "\x1b[2J", "").write(tmp_path / "seed=0", [])
    progress.stop()
    assert capsys.readouterr().err == "1 of 1  seed=0  failed: \\x1b[2J\n"


def test_a_process_ends_with_2(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "pinn_cli.main", "system.ndof=0"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert done.stderr.startswith("pinn-run: system.ndof=0: must be")
    assert list(tmp_path.iterdir()) == []
