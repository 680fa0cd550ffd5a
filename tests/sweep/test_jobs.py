"""What became of a sweep's jobs."""

from pathlib import Path

import pytest
from sweeps import made_sweep

from pinn_cli.settings.errors import DivergenceError, InputError, NotSoundError
from pinn_cli.sweep.jobs import FAILURE, Failure, Sweep


def test_every_expected_job_has_its_state(tmp_path: Path) -> None:
    sweep = made_sweep(tmp_path, ["seed=0,1,2,3", "system.ndof=3"], {"seed=0": "x\n1\n", "seed=2": None})
    (next(tmp_path.glob("seed=0*")).parent / sweep.jobs()[3].directory.name / ".hydra").mkdir(parents=True)
    (sweep.jobs()[3].directory / ".hydra" / "overrides.yaml").write_text("")
    assert [job.status for job in sweep.jobs()] == ["finished", "not started", "failed", "unfinished"]
    assert [job.ended for job in sweep.jobs()] == [True, False, True, False]
    assert [job.exit_status for job in sweep.jobs()] == [0, 0, 3, 0]
    assert [sweep.columns(job) for job in sweep.jobs()] == [{"seed": str(seed)} for seed in range(4)]


def test_jobs_of_an_earlier_sweep_in_that_directory_follow(tmp_path: Path) -> None:
    made_sweep(tmp_path, ["seed=10,9,0"], {"seed=10": "x\n1\n", "seed=9": "x\n2\n"})
    sweep = made_sweep(tmp_path, ["seed=0,1"], {"seed=1": "x\n3\n"})
    assert [job.directory.name for job in sweep.jobs()] == ["seed=0", "seed=1", "seed=9", "seed=10"]
    assert [sweep.columns(job) for job in sweep.jobs()][2:] == [{"seed": "9"}, {"seed": "10"}]


def test_a_sweeper_that_keeps_its_jobs_to_itself(tmp_path: Path) -> None:
    made_sweep(tmp_path, ["seed=0,1"], {"seed=1": "x\n3\n"})
    stored = tmp_path / "multirun.yaml"
    stored.write_text(stored.read_text().replace("BasicSweeper", "SearchSweeper"))
    assert [job.directory.name for job in Sweep.read(tmp_path).jobs()] == ["seed=1"]


@pytest.mark.parametrize(
    ("content", "told"),
    [(None, "multirun.yaml"), ("a: [", "cannot be read"), ("- 1", "cannot be read"), ("", "cannot be read")],
)
def test_what_is_no_sweep(tmp_path: Path, content: str | None, told: str) -> None:
    if content is not None:
        (tmp_path / "multirun.yaml").write_text(content)
    with pytest.raises(InputError, match="collect=.*the directory of a sweep") as refused:
        Sweep.read(tmp_path)
    assert told in str(refused.value)


@pytest.mark.parametrize(
    ("error", "status", "reason"),
    [
        (InputError("seed", 2, "another\nnumber"), 2, "seed=2: must be another number"),
        (DivergenceError("at  7"), 3, "at 7"),
        (NotSoundError("the verdict"), 4, "the verdict"),
        (ZeroDivisionError("no\nway"), 1, "ZeroDivisionError: no way"),
    ],
)
def test_a_failure_is_kept(tmp_path: Path, error: Exception, status: int, reason: str) -> None:
    Failure.of(error).write(tmp_path, [])
    kept = Failure.read(tmp_path)
    assert (kept.status, kept.reason) == (status, reason)
    assert type(error).__name__ in kept.traceback


def test_a_failure_that_cannot_be_read_is_one(tmp_path: Path) -> None:
    for content in ("{", '{"a": 1}', "[]"):
        (tmp_path / FAILURE).write_text(content)
        kept = Failure.read(tmp_path)
        assert "cannot be read" in kept.reason
