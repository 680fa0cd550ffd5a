"""Which files a report writes, and what it prints, with and without unknown parameters."""

import os
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from small_estimates import results_of

from pinn_cli.report import figures, run_report
from pinn_cli.report.results import LABELS
from pinn_cli.runs.machine import usable_cores
from pinn_cli.runs.stages import Stages
from pinn_cli.runs.writing import WriteError


def report_of(results, directory):
    """Write everything; the text."""
    report = run_report.RunReport(results, directory, Stages())
    text = report.text()
    assert not list(directory.iterdir())  # it is printed before anything is written
    with report.drawing():
        report.write()
    return text


@pytest.fixture
def results(make_case, monkeypatch):
    """Of the small estimate, with these parameters unknown; figures are tested where they are drawn."""
    monkeypatch.setattr(figures, "write_figures", lambda *_, **__: [])

    def results_with(*unknown: str, **changes: object):
        case = make_case(ndof=3, observed=2)
        parameters = [
            replace(p, parameter=replace(p.parameter, unknown=p.name in unknown, prior_std=p.prescribed))
            for p in case.estimate.parameters
        ]
        changes = {"correlation": np.eye(len(parameters)), "parameters": parameters, **changes}
        return results_of(case, estimate=replace(case.estimate, **changes))

    return results_with


COLUMNS = {
    "drift": "connection peak std lower_90 upper_90 time_of_peak true_peak true_time_of_peak error_percent",
    "energy": "connection dissipated std lower_90 upper_90 share_percent true error_percent",
    "fitness": "group quantity fitness_percent range_fitness_percent",
    "free_run": "against group quantity fitness_percent range_fitness_percent",
    "identifiability": "parameter prior_std std std_ratio relative_std_percent largest_correlation correlated_with"
    " verdict",
    "modes": "mode frequency lower_90 upper_90 damping_ratio damping_ratio_lower_90 damping_ratio_upper_90 mac"
    " prescribed_frequency prescribed_damping_ratio true_frequency true_damping_ratio frequency_error_percent"
    " damping_ratio_error_percent true_mac shape_1 shape_2 shape_3",
    "parameters": "parameter true prescribed start estimate error_percent std lower_90 upper_90",
    "residuals": "quantity dof samples signal_rms residual_rms nmse_percent sigma residual_over_sigma mean_residual"
    " whiteness largest_autocorrelation spectrum_deviation band_low_hz band_high_hz band_share_percent"
    " free_run_nmse_percent clipped_percent constant_percent channel",
}


def test_the_columns_that_other_programs_read(results, tmp_path):
    report_of(results("k_2"), tmp_path)
    for name, columns in COLUMNS.items():
        assert list(pd.read_csv(tmp_path / f"{name}.csv")) == [*LABELS, *columns.split()], name


def test_unknown_parameters_bring_their_tables_and_verdict(results, tmp_path):
    text = report_of(results("k_2", "kappa_2"), tmp_path)
    table = pd.read_csv(tmp_path / "identifiability.csv").set_index("parameter")
    assert table["std_ratio"].to_numpy() == pytest.approx(0.02)
    correlation = pd.read_csv(tmp_path / "correlation.csv", index_col="parameter")
    assert list(correlation) == list(correlation.index) == list(table.index)
    assert text.splitlines()[2].startswith("k_2 *")


@pytest.mark.parametrize(("unknown", "found"), [((), []), (("k_2",), ["identifiability.csv"])])
def test_what_there_is_not_brings_no_table(results, tmp_path, unknown, found):
    report_of(results(*unknown, correlation=None), tmp_path)
    assert [path.name for name in ("correlation", "identifiability") for path in tmp_path.glob(f"{name}*")] == found


def test_an_error_of_a_figure_reaches_the_user_and_leaves_no_run_record(results, tmp_path, monkeypatch):
    def refuse(*_: object) -> None:
        raise WriteError("figures/response.png", "No space left on device")

    monkeypatch.setattr(figures, "write_figures", refuse)
    report = run_report.RunReport(results(), tmp_path, Stages())
    with pytest.raises(WriteError, match="No space left"), report.drawing():
        report.write()
    assert not (tmp_path / "run.json").exists()


def alive(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def interrupt_when(happened):
    while not happened():
        time.sleep(0.01)
    raise KeyboardInterrupt


def test_drawing_ends_with_what_is_written_beside_it(results, tmp_path, monkeypatch):
    def draw(_results: object, directory: Path, *_: int) -> None:
        (directory / f"{os.getpid()}.drawing").touch()
        (directory / ".response.1.partial.png").touch()
        time.sleep(30.0)

    monkeypatch.setattr(figures, "write_figures", draw)
    report = run_report.RunReport(results(), tmp_path, Stages())
    if len(usable_cores()) < 2 or not sys.platform.startswith("linux"):
        pytest.skip("drawn in this process")
    monkeypatch.setattr(report, "write", lambda: interrupt_when(lambda: list(tmp_path.glob("*.drawing"))))
    with pytest.raises(KeyboardInterrupt), report.drawing():
        report.write()
    until = time.monotonic() + 10.0
    processes = {int(file.stem) for file in tmp_path.glob("*.drawing")}
    while any(map(alive, processes)) and time.monotonic() < until:
        time.sleep(0.01)
    assert not any(map(alive, processes))
    assert not list(tmp_path.glob("*partial*"))
