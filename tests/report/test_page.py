"""The page of a run: it is whole, loads nothing, and says what was found; modes move as their shapes are."""

import re

import numpy as np
import pandas as pd
import pytest
from html_pages import Checked
from small_estimates import results_of

from pinn_cli.report import figures
from pinn_cli.report.estimates import ModeEstimates
from pinn_cli.report.figures.sensors import history_figure
from pinn_cli.report.figures.structure import MOST_MOVING, moving_modes
from pinn_cli.report.figures.style import save
from pinn_cli.report.page import CAPTIONS, Page, figures_in, next_steps, sheet_of
from pinn_cli.report.run_report import RunReport
from pinn_cli.report.text import Column
from pinn_cli.runs.stages import Stages
from pinn_cli.verdict.finding import Finding, Verdict


def draw_one(results, directory, *_):
    """A figure instead of all, which are tested where they are drawn."""
    return save(history_figure(results.estimate.history), directory / "figures", "history")


def test_a_run_that_draws_leaves_a_page_that_loads_nothing(make_case, tmp_path, monkeypatch):
    monkeypatch.setattr(figures, "write_figures", draw_one)
    results = results_of(make_case(ndof=3, observed=2))
    report = RunReport(results, tmp_path, Stages())
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


def test_without_figures_there_is_no_page(make_case, tmp_path):
    RunReport(results_of(make_case(ndof=2, observed=1)), tmp_path, Stages()).write()
    assert (tmp_path / "run.json").is_file()
    assert not (tmp_path / "report.html").exists()


def test_names_of_anybody_are_text(make_case, tmp_path):
    (tmp_path / "record_2").mkdir()
    save(history_figure(make_case().estimate.history), tmp_path / "record_2" / "figures", "history")
    sheet = sheet_of(("a", "b", "c"), {"x": Column("x", 2)}, pd.DataFrame({"x": ["<b>\x1b[31m"]}))
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
        assert reach / np.abs(reach).max() == pytest.approx(
            modes.shapes[:, mode] / np.abs(modes.shapes[:, mode]).max(), abs=0.01
        )
        assert picture.count("<line") == ndof  # a connection each, one to the ground
