"""Joining the tables of a sweep's jobs."""

from __future__ import annotations

from pathlib import Path

from sweeps import made_sweep

from pinn_cli.sweep.jobs import Sweep
from pinn_cli.sweep.tables import write_tables


def joined(sweep: Sweep, name: str) -> str:
    written = write_tables(sweep, sweep.jobs())
    assert (sweep.directory / name in written) == (sweep.directory / name).exists()
    return (sweep.directory / name).read_text() if sweep.directory / name in written else ""


def test_swept_settings_lead_and_cells_are_copied(tmp_path: Path) -> None:
    tables = {f"noise.snr_db={snr}": f"seed,x\n0,9{snr}.10\n" for snr in (50, 5)}
    sweep = made_sweep(tmp_path, ["noise.snr_db=50,5", "system.ndof=3"], tables)
    assert joined(sweep, "fitness.csv") == (
        "noise.snr_db,seed,x,status,reason\n50,0,950.10,finished,\n5,0,95.10,finished,\n"
    )
    assert joined(sweep, "free_run.csv") == ""


def test_a_column_that_is_there_is_not_doubled(tmp_path: Path) -> None:
    sweep = made_sweep(tmp_path, ["seed=4,5"], {"seed=4": "seed,x\n4,1\n", "seed=5": "seed,x\n5,2\n"})
    assert joined(sweep, "fitness.csv") == "seed,x,status,reason\n4,1,finished,\n5,2,finished,\n"


def test_jobs_stand_in_their_order_and_failed_ones_say_why(tmp_path: Path) -> None:
    tables = {f"seed={seed}": None if seed == 2 else f"seed,x\n{seed},0\n" for seed in (10, 0, 2, 9)}
    sweep = made_sweep(tmp_path, ["seed=10,0,2,9,7"], tables)
    assert joined(sweep, "fitness.csv") == (
        'seed,x,status,reason\n10,0,finished,\n0,0,finished,\n2,,failed,"no luck, at all"\n9,0,finished,\n'
    )
    assert joined(sweep, "jobs.csv") == (
        "seed,status,reason,seconds,directory\n"
        "10,finished,,1.5,seed=10\n0,finished,,1.5,seed=0\n"
        '2,failed,"no luck, at all",,seed=2\n9,finished,,1.5,seed=9\n7,not started,,,seed=7\n'
    )


def test_jobs_with_different_columns_share_a_table(tmp_path: Path) -> None:
    sweep = made_sweep(tmp_path, ["case=a,b"], {"case=a": "x\n1\n", "case=b": "y,x\n3,2\n"})
    assert joined(sweep, "fitness.csv") == "case,x,y,status,reason\na,1,,finished,\nb,2,3,finished,\n"


def test_a_sweep_without_tables_writes_its_jobs_alone(tmp_path: Path) -> None:
    sweep = made_sweep(tmp_path, ["seed=1,2"], {})
    assert joined(sweep, "fitness.csv") == ""
    assert joined(sweep, "jobs.csv").count("not started") == 2
