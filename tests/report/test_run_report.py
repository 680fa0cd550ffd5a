"""Which files a report writes, and what it prints and shows on its page."""

import os
import re
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calls import MEASURED, PinnRun
from html_pages import Checked
from interrupted_runs import gone
from small_estimates import results_of
from small_problems import measured, small_chain

from pinn_cli.report import figures, run_report
from pinn_cli.report.estimates import ModeEstimates
from pinn_cli.report.figures import save
from pinn_cli.report.figures.sensors import history_figure
from pinn_cli.report.figures.structure import MOST_MOVING, moving_modes
from pinn_cli.report.page import CAPTIONS, Page, figures_in, next_steps, sheet_of
from pinn_cli.report.results import LABELS
from pinn_cli.report.run_report import RunReport
from pinn_cli.report.text import Column, Shown
from pinn_cli.runs.process import usable_cores
from pinn_cli.runs.stages import Stages
from pinn_cli.runs.writing import WriteError
from pinn_cli.verdict.finding import Finding, Verdict


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


def test_drawing_ends_with_what_is_written_beside_it(results, tmp_path, monkeypatch):
    def draw(_results: object, directory: Path, *_: int) -> None:
        (directory / f"{os.getpid()}.drawing").touch()
        (directory / ".response.1.partial.png").touch()
        time.sleep(30.0)

    monkeypatch.setattr(figures, "write_figures", draw)
    report = run_report.RunReport(results(), tmp_path, Stages())
    if len(usable_cores()) < 2 or not sys.platform.startswith("linux"):
        pytest.skip("drawn in this process")

    def write():
        while not list(tmp_path.glob("*.drawing")):
            time.sleep(0.01)
        raise KeyboardInterrupt

    monkeypatch.setattr(report, "write", write)
    with pytest.raises(KeyboardInterrupt), report.drawing():
        report.write()
    until = time.monotonic() + 10.0
    processes = {int(file.stem) for file in tmp_path.glob("*.drawing")}
    while not all(map(gone, processes)) and time.monotonic() < until:
        time.sleep(0.01)
    assert all(map(gone, processes))
    assert not list(tmp_path.glob("*partial*"))


SETTINGS = (
    *MEASURED, "system.m=10", "system.c=1", "system.k=15", "system.kappa=100",
    "data=csv", "data.path=rig.csv", "data.time=t", "data.force={1: f}",
    "data.acceleration={1: a1, 2: a2, 3: a3}", "figures=false",
)  # fmt: skip


@pytest.fixture
def rig(tmp_path: Path) -> None:
    record = measured(small_chain(), snr_db=40.0).record
    columns = {f"a{dof}": record.acceleration[:, dof - 1] for dof in (1, 2, 3)}
    pd.DataFrame({"t": record.time, "f": record.force[:, 0], **columns}).to_csv(tmp_path / "rig.csv", index=False)


@pytest.mark.usefixtures("rig")
def test_it_is_told_sensor_by_sensor_with_the_baseline_beside(pinn_run: PinnRun) -> None:
    outcome = pinn_run(*SETTINGS, "baseline=kalman_smoother").done()
    paragraphs = outcome.out.split("\n\n")
    assert "kalman_smoother (%)" in paragraphs[0].splitlines()[0]
    assert "fitness" not in outcome.out
    # Of the force there is no free run: the only cell without a number.
    assert sum(line.split().count("-") for line in outcome.out.splitlines()) == 1
    assert "\nseconds: pinn " in outcome.out
    table = pd.read_csv(outcome.directory / "residuals.csv")
    assert table["estimator"].tolist() == ["pinn"] * 4 + ["kalman_smoother"] * 4
    ours = table[table["estimator"] == "pinn"]
    assert ours["nmse_percent"].between(0.001, 0.1).all()
    assert ours["sigma"].notna().all()
    assert ours["free_run_nmse_percent"].notna().tolist() == [True, True, True, False]
    assert np.isfinite(table["whiteness"]).all()


@pytest.mark.usefixtures("rig")
def test_a_held_out_sensor_is_scored_by_itself(pinn_run: PinnRun) -> None:
    outcome = pinn_run(*SETTINGS, "data.holdout=[2]").done()
    (fitness,) = [part for part in outcome.out.split("\n\n") if "\nDOFs " in part]
    lines = fitness.splitlines()
    assert lines[1].split() == ["DOFs", "accel.", "accel."]
    assert [line.split()[0] for line in lines[3:]] == ["all", "unobserved", "dof_2", "*"]
    table = pd.read_csv(outcome.directory / "fitness.csv")
    assert len(table) == 4 * (5 + 3)
    scores = table.set_index(["group", "quantity"])["fitness_percent"]
    assert scores["dof_2", "acceleration"] > 80
    assert pd.isna([scores["dof_2", "displacement"], scores["dof_1", "acceleration"]]).all()


def draw_one(results, directory, *_):
    """A figure instead of all, which are tested where they are drawn."""
    return save(history_figure(results.estimate.history), directory / "figures", "history")


def test_a_run_that_draws_leaves_a_page_that_loads_nothing(make_case, tmp_path, monkeypatch):
    monkeypatch.setattr(figures, "write_figures", draw_one)
    results = results_of(make_case(ndof=3, observed=2))
    report = RunReport(results, tmp_path, Stages())
    report.write()
    assert (tmp_path / "run.json").is_file()
    assert not (tmp_path / "report.html").exists()  # without figures there is no page
    with report.drawing():
        report.write()
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    loaded = [place for place in Checked(text).loaded if not place.startswith("#")]
    assert len(loaded) == len(list((tmp_path / "figures").glob("*.png"))) == 1
    assert all(place.startswith("data:image/png;base64,") for place in loaded)
    assert "<script" not in text
    assert all(caption in text for caption in (CAPTIONS["history"], "Natural modes", "What to do next", "Fitness"))
    estimate = results.estimate.parameters[0].estimate
    assert f"<td>{estimate:.5g}"[:9] in text
    assert "nan" not in re.sub(r"base64,[^\"]*", "", text)


def test_names_of_anybody_are_text(make_case, tmp_path):
    (tmp_path / "record_2").mkdir()
    save(history_figure(make_case().estimate.history), tmp_path / "record_2" / "figures", "history")
    sheet = sheet_of("a", "b", Shown({"x": Column("x", 2)}, pd.DataFrame({"x": ["<b>\x1b[31m"]})))
    reason = Finding("gain", "x", "the channel <script>alert(1)</script> is late")
    Page("my_rig", Verdict("failed", (reason,)), [sheet]).write(tmp_path)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    Checked(text)
    assert "<script" not in text
    assert "&lt;script&gt;" in text
    assert "\x1b" not in text
    assert "&lt;b&gt;\\x1b[31m" in text
    assert "Do not use the numbers" in text
    assert [caption for caption, _ in figures_in(tmp_path)] == [f"record 2: {CAPTIONS['history']}"]


def test_what_is_not_sound_is_mended_first(make_case):
    results = results_of(make_case(ndof=2, observed=1))
    first = next_steps(results, Verdict("failed", (Finding("gain", "x", "wrong"),)))[0][0]
    assert first.startswith("Mend")
    assert not any(step.startswith("Mend") for step, _ in next_steps(results, Verdict("sound")))


@pytest.mark.parametrize("ndof", [2, 8])
def test_masses_move_by_their_shapes(make_case, ndof):
    results = results_of(make_case(ndof=ndof, observed=1))
    modes = ModeEstimates.of(results.prescribed, results.estimate)
    pictures = list(moving_modes(results.prescribed, modes))
    assert len(pictures) == min(ndof, MOST_MOVING)
    for mode, picture in enumerate(pictures):
        ends = re.findall(r'attributeName="cx" values="([-\d.]+);([-\d.]+);', picture)
        reach = np.array([float(a) - float(b) for a, b in ends])
        shape = modes.shapes["estimate"][:, mode]
        assert reach / np.abs(reach).max() == pytest.approx(shape / np.abs(shape).max(), abs=0.01)
        assert picture.count("<line") == ndof  # a connection each, one to the ground
