"""Joining the tables of a sweep's jobs."""

from __future__ import annotations

from pathlib import Path

from pinn_cli.report.sweep import join_tables


def job(sweep: Path, number: int, overrides: list[str], table: str | None) -> None:
    (sweep / str(number) / ".hydra").mkdir(parents=True)
    (sweep / str(number) / ".hydra" / "overrides.yaml").write_text("".join(f"- {line}\n" for line in overrides))
    if table is not None:
        (sweep / str(number) / "fitness.csv").write_text(table)


def test_swept_settings_lead_and_cells_are_copied(tmp_path: Path) -> None:
    for number, snr in enumerate((50, 5)):
        job(tmp_path, number, [f"noise.snr_db={snr}", "system.ndof=3"], f"seed,fitness_percent\n0,9{number}.10\n")
    join_tables(tmp_path, "fitness.csv", ["noise.snr_db=50,5", "system.ndof=3"])
    assert (tmp_path / "fitness.csv").read_text() == "noise.snr_db,seed,fitness_percent\n50,0,90.10\n5,0,91.10\n"


def test_a_column_that_is_there_is_not_doubled(tmp_path: Path) -> None:
    job(tmp_path, 0, ["seed=4"], "seed,x\n4,1\n")
    join_tables(tmp_path, "fitness.csv", ["seed=4,5"])
    assert (tmp_path / "fitness.csv").read_text() == "seed,x\n4,1\n"


def test_jobs_stand_in_their_order_and_failed_ones_are_passed_over(tmp_path: Path) -> None:
    for number in (0, 2, 9, 10, 11):
        job(tmp_path, number, [f"+a={number}"], None if number == 2 else f"x\n{number}\n")
    join_tables(tmp_path, "fitness.csv", ["+a=0,2,9,10,11"])
    assert (tmp_path / "fitness.csv").read_text() == "a,x\n0,0\n9,9\n10,10\n11,11\n"


def test_jobs_with_different_columns_share_a_table(tmp_path: Path) -> None:
    job(tmp_path, 0, ["k=a"], "x\n1\n")
    job(tmp_path, 1, ["k=b"], "x,y\n2,3\n")
    join_tables(tmp_path, "fitness.csv", ["k=a,b"])
    assert (tmp_path / "fitness.csv").read_text() == "k,x,y\na,1,\nb,2,3\n"


def test_a_sweep_without_tables_writes_none(tmp_path: Path) -> None:
    job(tmp_path, 0, ["seed=1"], None)
    assert join_tables(tmp_path, "fitness.csv", ["seed=1,2"]) is None
    assert not (tmp_path / "fitness.csv").exists()
