"""Which files a report writes, and what it prints, with and without unknown parameters."""

from __future__ import annotations

import json
import os
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calls import SMALL
from fake_posteriors import DUFFING, make_result, make_samples
from small_estimates import parameter_estimate

from pinn_cli.cli.config import RunConfig
from pinn_cli.report import figures, run_report
from pinn_cli.report.parameters import PARAMETER_COLUMNS
from pinn_cli.report.results import LABELS, Results
from pinn_cli.runs.cores import usable_cores
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
def reported(composed, make_case, tmp_path, monkeypatch):
    """Report the small estimate with these parameters unknown; returns the folder and the text."""
    # They are tested where they are drawn, and take seconds.
    monkeypatch.setattr(figures, "write_figures", lambda *_, **__: [])

    def report(*unknown: str, **changes: object):
        case = make_case(ndof=3, observed=2)
        parameters = [
            replace(p, parameter=replace(p.parameter, unknown=p.name in unknown, prior_std=p.prescribed))
            for p in case.estimate.parameters
        ]
        changes = {"correlation": np.eye(len(parameters)), **changes}
        estimate = replace(case.estimate, parameters=parameters, **changes)
        config = RunConfig.read(composed(*SMALL))
        results = Results(config.description, config.structure, case.record, case.truth, estimate)
        return tmp_path, report_of(results, tmp_path)

    return report


def test_unknown_parameters_bring_their_tables_and_verdict(reported):
    directory, text = reported("k_2", "kappa_2")
    table = pd.read_csv(directory / "identifiability.csv").set_index("parameter")
    assert table["std_ratio"].to_numpy() == pytest.approx(0.02)
    assert set(table["verdict"]) == {"well determined"}
    correlation = pd.read_csv(directory / "correlation.csv", index_col="parameter")
    assert list(correlation) == list(correlation.index) == list(table.index)
    assert text.splitlines()[2].startswith("k_2 *")
    assert "every unknown parameter is well determined" in text


def test_prescribed_parameters_alone_bring_none(reported):
    directory, text = reported()
    assert not list(directory.glob("identifiability*"))
    assert not list(directory.glob("correlation*"))
    assert "*" not in text.split("\n\n")[0]


def test_a_training_without_correlation_writes_no_matrix(reported):
    directory, _ = reported("k_2", correlation=None)
    assert (directory / "identifiability.csv").is_file()
    assert not (directory / "correlation.csv").exists()


@pytest.mark.parametrize("unknown", [(), ("k_2",)])
def test_the_columns_of_parameters_csv_are_agreed(reported, unknown):
    directory, _ = reported(*unknown)
    assert list(pd.read_csv(directory / "parameters.csv")) == [*LABELS, *PARAMETER_COLUMNS]


def test_a_posterior_brings_its_files_parameters_and_verdict(composed, make_case, tmp_path, monkeypatch):
    monkeypatch.setattr(figures, "write_figures", lambda *_, **__: [])
    case = make_case(ndof=3, observed=3)
    start = [parameter_estimate(name, 1.0, 1.0, 0.1, 0.9, 1.1) for name in DUFFING]
    samples = make_samples()
    posterior = make_result(samples, None, "3 divergences")
    config, estimate = RunConfig.read(composed(*SMALL)), replace(case.estimate, parameters=start)
    results = Results(config.description, config.structure, case.record, case.truth, estimate, posterior=posterior)
    text = report_of(results, tmp_path)
    table = pd.read_csv(tmp_path / "parameters.csv").set_index("parameter")
    assert table["estimate"].to_numpy() == pytest.approx(samples.draws.mean(axis=(0, 1)))
    assert (tmp_path / "posterior.nc").is_file()
    assert (tmp_path / "figures" / "posterior_pairs.png").is_file()
    assert "quality check FAILED: 3 divergences" in text
    record = json.loads((tmp_path / "run.json").read_text())["posterior"]
    assert (record["method"], record["chains"], record["quality_check"]) == ("marginal", 4, ["3 divergences"])


def test_an_error_of_a_figure_reaches_the_user_and_leaves_no_run_record(composed, make_case, tmp_path, monkeypatch):
    def refuse(*_: object) -> None:
        raise WriteError("figures/response.png", "No space left on device")

    monkeypatch.setattr(figures, "write_figures", refuse)
    case, config = make_case(ndof=3, observed=2), RunConfig.read(composed(*SMALL))
    results = Results(config.description, config.structure, case.record, case.truth, case.estimate)
    report = run_report.RunReport(results, tmp_path, Stages())
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


def test_drawing_ends_with_what_is_written_beside_it(composed, make_case, tmp_path, monkeypatch):
    def draw(_results: object, directory: Path, *_: int) -> None:
        (directory / f"{os.getpid()}.drawing").touch()
        (directory / ".response.1.partial.png").touch()
        time.sleep(30.0)

    monkeypatch.setattr(figures, "write_figures", draw)
    case, config = make_case(ndof=3, observed=2), RunConfig.read(composed(*SMALL))
    results = Results(config.description, config.structure, case.record, case.truth, case.estimate)
    report = run_report.RunReport(results, tmp_path, Stages())
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
