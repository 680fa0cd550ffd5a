"""What became of a sweep's jobs, and `pinn-run collect=DIRECTORY`: their tables, one below the other."""

from pathlib import Path

import pandas as pd
import pytest
from calls import PinnRun
from sweeps import made_sweep

from pinn_cli.settings.errors import DivergenceError, InputError, NotSoundError
from pinn_cli.sweep.collect import write_tables
from pinn_cli.sweep.jobs import FAILURE, Failure, Sweep

HEAD = "estimator,group,quantity,fitness_percent,range_fitness_percent\n"


def table(percent: float) -> str:
    return HEAD + "".join(f"pinn,all,{quantity},{percent},{percent}\n" for quantity in ("displacement", "velocity"))


def test_a_sweep_that_was_cut_off_is_put_together(pinn_run: PinnRun, tmp_path: Path) -> None:
    tables = {"system.ndof=3": table(99.0), "system.ndof=6": table(90.0), "system.ndof=9": None}
    made_sweep(tmp_path / "sweep", ["system.ndof=3,6,9,12"], tables)
    outcome = pinn_run("collect=sweep").done()
    assert outcome.out.startswith("4 jobs: 2 finished, 1 failed, 1 not started\n  system.ndof=9: no luck, at all\n")
    assert outcome.out.endswith("\nsweep\n")
    assert pd.read_csv(outcome.directory / "summary.csv")["fitness_percent_mean"].tolist() == [99, 99, 90, 90]
    assert {path.name for path in outcome.directory.glob("figures/*")} == {"fitness.png", "fitness.pdf"}
    assert len(pd.read_csv(outcome.directory / "jobs.csv")) == 4
    files = [tmp_path / "sweep" / name for name in ("fitness.csv", "jobs.csv", "summary.csv")]
    first = [file.read_bytes() for file in files]
    assert pinn_run("collect=sweep").out == outcome.out  # as often as it is collected
    assert [file.read_bytes() for file in files] == first


def test_a_sweep_that_has_not_begun(pinn_run: PinnRun, tmp_path: Path) -> None:
    made_sweep(tmp_path / "sweep", ["seed=0,1"], {})
    assert pinn_run("collect=sweep").out == "2 jobs: 2 not started\nsweep\n"
    assert [path.name for path in (tmp_path / "sweep").iterdir()] == ["multirun.yaml"]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["collect=nowhere"], "there is no such directory"),
        (["collect=."], "it holds no multirun.yaml"),
        (["collect=.", "seed=1"], "given alone; drop seed=1"),
        (["-m", "collect=."], "given alone; drop --multirun"),
    ],
)
def test_what_cannot_be_collected(pinn_run: PinnRun, arguments: list[str], told: str) -> None:
    pinn_run(*arguments).refused("pinn-run: collect=", told)


def joined(sweep: Sweep, name: str) -> str:
    write_tables(sweep, sweep.jobs())
    return (sweep.directory / name).read_text() if (sweep.directory / name).exists() else ""


COLUMNS = "estimator,group,quantity,fitness_percent,range_fitness_percent"


def row(first: str, percent: str) -> str:
    return f"{first},pinn,all,force,{percent},"


def test_swept_settings_lead_and_cells_are_copied(tmp_path: Path) -> None:
    tables = {f"noise.snr_db={snr}": f"seed,{COLUMNS}\n{row('0', f'{snr}.10')}\n" for snr in (50, 5)}
    sweep = made_sweep(tmp_path / "noises", ["noise.snr_db=50,5", "system.ndof=3"], tables)
    assert joined(sweep, "fitness.csv") == (
        f"noise.snr_db,seed,{COLUMNS},status,reason\n50,{row('0', '50.10')},finished,\n5,{row('0', '5.10')},finished,\n"
    )
    assert joined(sweep, "free_run.csv") == ""
    tables = {"case=a": f"{COLUMNS}\npinn,all,force,1,\n", "case=b": f"y,{COLUMNS}\n{row('3', '2')}\n"}
    sweep = made_sweep(tmp_path / "cases", ["case=a,b"], tables)
    assert joined(sweep, "fitness.csv") == (
        f"case,{COLUMNS},y,status,reason\na,pinn,all,force,1,,,finished,\nb,pinn,all,force,2,,3,finished,\n"
    )


def test_jobs_stand_in_their_order_and_failed_ones_say_why(tmp_path: Path) -> None:
    tables = {f"seed={seed}": None if seed == 2 else f"seed,{COLUMNS}\n{row(str(seed), '0')}\n" for seed in (9, 0, 2)}
    sweep = made_sweep(tmp_path, ["seed=9,0,2,7"], tables)
    assert joined(sweep, "fitness.csv") == (
        f"seed,{COLUMNS},status,reason\n{row('9', '0')},finished,\n{row('0', '0')},finished,\n"
        '2,,,,,,failed,"no luck, at all"\n'
    )
    assert joined(sweep, "jobs.csv") == (
        "seed,status,reason,seconds,directory\n9,finished,,1.5,seed=9\n0,finished,,1.5,seed=0\n"
        '2,failed,"no luck, at all",,seed=2\n7,not started,,,seed=7\n'
    )


@pytest.mark.parametrize("table", ["", "a,b\n1,2\n", f"{COLUMNS}\npinn,all,force,many,\n"])
def test_a_job_whose_table_is_damaged_has_failed(tmp_path: Path, table: str) -> None:
    sweep = made_sweep(tmp_path, ["case=a,b"], {"case=a": table})
    job, _ = write_tables(sweep, sweep.jobs())
    assert (job.status, job.exit_status) == ("failed", 2)
    assert job.reason.startswith("fitness.csv cannot be read: ")


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
    # A sweeper that keeps its jobs to itself.
    stored = tmp_path / "multirun.yaml"
    stored.write_text(stored.read_text().replace("BasicSweeper", "SearchSweeper"))
    assert [job.directory.name for job in Sweep.read(tmp_path).jobs()] == ["seed=1", "seed=9", "seed=10"]


@pytest.mark.parametrize("content", ["a: [", "- 1", ""])
def test_what_is_no_sweep(tmp_path: Path, content: str) -> None:
    (tmp_path / "multirun.yaml").write_text(content)
    with pytest.raises(InputError, match="collect=.*the directory of a sweep") as refused:
        Sweep.read(tmp_path)
    assert "multirun.yaml cannot be read" in str(refused.value)


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
    for content in ("{", '{"a": 1}', "[]"):
        (tmp_path / FAILURE).write_text(content)
        assert "cannot be read" in Failure.read(tmp_path).reason
