"""What `make paper` leaves behind: tables in three formats, figures and one report, from made-up runs."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pinn_cli.paper.__main__ import main
from pinn_cli.paper.case_runs import CaseFailedError
from pinn_cli.paper.figure_list import PAPER_FIGURES
from pinn_cli.paper.figures import draw, draw_figures, equivalent_linear
from pinn_cli.paper.making import make_figures, make_paper
from pinn_cli.paper.saved_run import read_posterior, read_response, read_true_parameters
from pinn_cli.paper.sheet import Row, Sheet, number, written
from pinn_cli.paper.shortfalls import fitness_reason, parameter_reason

VOID = {"meta", "img", "br"}
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)


class Checked(HTMLParser):
    """Every element is closed, in its order; what the document loads and which ids it has and links to."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loaded: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.count: dict[str, int] = {}
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.count[tag] = self.count.get(tag, 0) + 1
        if tag not in VOID:
            self.open.append(tag)
        self.loaded += [given[name] for name in ("src", "srcset", "data") if name in given]
        self.ids += [given["id"]] if "id" in given else []
        (self.links if tag == "a" else self.loaded).extend([given["href"]] if "href" in given else [])

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_report_is_well_formed_and_loads_nothing(paper):
    text = (paper / "report.html").read_text(encoding="utf-8")
    checked = Checked(text)
    assert checked.count["img"] == len(PAPER_FIGURES) + 1 == 15
    assert all(place.startswith("data:image/png;base64,") for place in checked.loaded)
    assert len(checked.ids) == len(set(checked.ids))
    assert {link.removeprefix("#") for link in checked.links} <= set(checked.ids)
    assert "url(" not in text
    assert "@import" not in text
    assert "nan" not in re.sub(r"base64,[^\"]*", "", text)
    assert str(paper.parent) not in text


def test_report_says_what_was_run(paper):
    text = (paper / "report.html").read_text(encoding="utf-8")
    assert "30 runs, 150 s" in text
    assert "numpy" in text
    assert "sp_5dof_snr10, k_2" in text  # 0.8 % off where 0.145 % is published
    assert "Barely identifiable" not in text
    assert "no estimate of pe_2dof_duffing, pe_2dof_van_der_pol" in text


@pytest.mark.parametrize("number", range(1, 7))
def test_tables_are_written_in_three_formats(paper, number):
    place = paper / "tables"
    frame = pd.read_csv(place / f"table{number}.csv")
    assert len(frame)
    lines = (place / f"table{number}.md").read_text().splitlines()
    assert len({line.count("|") for line in lines if line.startswith("| ")}) == 1
    _check_latex((place / f"table{number}.tex").read_text())


def _check_latex(text: str) -> None:
    plain = re.sub(r"\\[{}%&#_$]", "", re.sub(r"^%.*$", "", text, flags=re.MULTILINE)).replace(r"{!}{%", "{!}{")
    assert plain.count("{") == plain.count("}")
    assert "_" not in re.sub(r"\$[^$]*\$", "", plain)
    environments = re.findall(r"\\(begin|end){([a-z*]+)}", plain)
    assert environments == [("begin", "table*"), ("begin", "tabular"), ("end", "tabular"), ("end", "table*")]
    assert [plain.count(rule) for rule in (r"\toprule", r"\bottomrule")] == [1, 1]
    columns = len(re.search(r"\\begin{tabular}{([lr]+)}", plain)[1])
    for line in plain.splitlines():
        if line.endswith(r"\\"):
            spans = sum(int(span) - 1 for span in re.findall(r"\\multicolumn{(\d+)}", line))
            assert line.count("&") + 1 + spans == columns
    assert text.isascii()


def test_table2_holds_published_ours_and_smoother(paper):
    text = (paper / "tables" / "table2.md").read_text()
    row = "| 6 DOFs, Duffing, no error, 50 dB | published | 98.57 | 99.30 | 99.11 | - |"
    assert row in text
    assert "|  | ours, uncertain parameters | 98.77 ▲ | 99.50 ▲ | 99.31 ▲ | - |" in text
    assert "|  | Kalman smoother | 98.67 ▲ | 99.40 ▲ |" in text
    assert "|  | ours, uncertain parameters, printed | 90.00 | 90.00 |" in text


def test_table1_has_estimates_of_the_wrong_values(paper):
    frame = pd.read_csv(paper / "tables" / "table1.csv")
    assert frame[["drawn", "uncertain", "kalman_smoother"]].notna().all().all()
    assert r"\textbf{" in (paper / "tables" / "table1.tex").read_text()


def test_table6_has_no_smoother_where_it_found_nothing(paper):
    text = (paper / "tables" / "table6.md").read_text()
    assert "| κ_1/μ_1 | published | 100 | 99.21 | 0.79 | 0.65 | 0.75 |" in text
    assert "ours, conditional posterior" in text
    assert "Kalman smoother" not in text


def test_every_figure_as_png_and_pdf(paper):
    names = {f"figure{number:02d}.{suffix}" for number in range(1, 15) for suffix in ("png", "pdf")}
    assert {file.name for file in (paper / "figures").iterdir()} == names
    for file in (paper / "figures").iterdir():
        assert file.read_bytes().startswith(b"\x89PNG" if file.suffix == ".png" else b"%PDF")


@pytest.mark.usefixtures("nothing_drawn")
def test_figures_alone_need_only_their_runs(tmp_path, runner):
    assert make_figures(tmp_path, runner) == 0
    assert len(runner.calls) == len({figure.run for figure in PAPER_FIGURES if figure.run}) == 10
    assert not (tmp_path / "report.html").exists()


@pytest.mark.usefixtures("nothing_drawn")
def test_a_failed_case_leaves_a_gap_that_the_report_tells(tmp_path, runner):
    runner.failing = {"sr_20dof_snr50": CaseFailedError("sr_20dof_snr50, fixed parameters: exit status 3")}
    assert make_paper(tmp_path, runner) == 1
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "exit status 3" in text
    assert "Not drawn: the run sr_20dof_snr50_uncertain is missing" in text
    Checked(text)


@pytest.mark.usefixtures("nothing_drawn")
def test_values_that_are_worse_are_listed_with_a_reason(tmp_path, runner):
    runner.offset = -0.2
    make_paper(tmp_path, runner)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "sr_6dof_snr50, All DOFs, displacement" in text
    assert "The smoother reaches 98.47 % on the same record" in text


def test_reasons():
    row = {"case": "sr_6dof_snr10", "range_fitness_percent": 95.0}
    assert "the record and the model allow" in fitness_reason(row, 95.05)
    assert "the shortfall is ours" in fitness_reason(row, 97.0)
    assert "cannot be told apart" in fitness_reason(row, math.nan)
    row = {"case": "sp_5dof_snr10", "parameter": "kappa_2", "std": 25.0, "true": 100.0, "estimate": 56.0}
    assert "Barely identifiable" in parameter_reason(row | {"truth_inside": False})
    assert "equivalent stiffness" in parameter_reason(row | {"case": "sp_5dof_linear"})
    assert "holds the truth" in parameter_reason(row | {"parameter": "k_2", "truth_inside": True})
    outside = parameter_reason(row | {"parameter": "k_2", "truth_inside": False})
    assert "1.8 standard deviations" in outside


def test_a_sheet_checks_itself():
    with pytest.raises(ValueError, match="groups span"):
        Sheet("t", "t", "", ("a",), (("g", 1),), ("x", "y"), ())
    with pytest.raises(ValueError, match="does not fit"):
        Sheet("t", "t", "", ("a",), (("", 1),), ("x",), (Row(("h",), ()),))


def test_symbols_and_escapes():
    assert written("kappa_2/mu_2", "latex") == r"$\kappa_{2}$/$\mu_{2}$"
    assert written("kappa_2", "html") == "<i>κ</i><sub>2</sub>"
    assert written("acceleration", "plain") == "ü"
    assert written("a_b & 5 %", "latex") == r"a\_b \& 5 \%"
    assert written("‖x − x̃‖", "latex") == r"$\|$x $-$ $\tilde{x}$$\|$"
    assert written("<b>", "html") == "&lt;b&gt;"
    assert number(math.nan, ".2f", "better").mark == ""


def test_a_response_comes_back_as_it_was(paper, make_case):
    saved = read_response(paper / "runs" / "sr_6dof_snr50_uncertain" / "response.nc")
    case = make_case(ndof=3, samples=60)
    np.testing.assert_array_equal(saved.estimate.response.velocity, case.estimate.response.velocity)
    np.testing.assert_array_equal(saved.estimate.std.force, case.estimate.std.force)
    np.testing.assert_array_equal(saved.record.acceleration, case.record.acceleration)
    np.testing.assert_array_equal(saved.record.force, case.record.force)
    np.testing.assert_array_equal(saved.record.observed, case.record.observed)
    assert saved.truth is not None
    np.testing.assert_array_equal(saved.truth.force, case.truth.response.force)
    assert list(saved.baselines) == ["kalman_smoother"]


def test_a_posterior_comes_back(paper):
    run = paper / "runs" / "pe_2dof_duffing_marginal"
    samples, units = read_posterior(run / "posterior.nc")
    assert samples.names == ("c_1", "c_2", "k_1", "k_2", "kappa_1", "kappa_2")
    assert samples.draws.shape == (4, 200, 6)
    assert units["kappa"] == "N/m^3"
    true = read_true_parameters(run / "parameters.csv")
    assert true is not None
    np.testing.assert_array_equal(true["kappa"], [100.0, 100.0])


def test_a_figure_of_a_run_needs_one(tmp_path):
    with pytest.raises(ValueError, match="figure04"):
        draw(PAPER_FIGURES[3], None)
    assert draw_figures({}, tmp_path, PAPER_FIGURES[3:]) == set()


def test_the_equivalent_linear_chain_moves_differently():
    linear = equivalent_linear("sp_5dof_linear")
    assert linear.displacement.shape == (4096, 5)
    assert np.isfinite(linear.displacement).all()
    assert 0.01 < linear.displacement.std() < 1.0


def test_an_interrupt_ends_with_130(tmp_path, monkeypatch, capsys):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("pinn_cli.paper.making.make_runs", interrupted)
    assert main(["figures", "--output", str(tmp_path)]) == 130
    assert "goes on" in capsys.readouterr().err


def browse(folder: Path, *arguments: str) -> str:
    """What headless Chromium writes to its standard output."""
    quiet = ("--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder / 'profile'}")
    command = [str(BROWSER), *quiet, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout


@pytest.mark.skipif(BROWSER is None, reason="no headless Chromium on PATH")
@pytest.mark.parametrize("width", [400, 1280])
def test_a_browser_renders_the_report(paper, tmp_path, width):
    """The page is laid out, every image is decoded, and the page itself does not scroll sideways."""
    probe = tmp_path / "probe.html"
    script = (
        "<script>addEventListener('load', () => { const page = document.documentElement; "
        "const seen = [...document.images].filter(i => i.naturalWidth > 300).length; "
        "document.title = `images ${seen} overflow ${page.scrollWidth - page.clientWidth}`; });</script></body>"
    )
    probe.write_text((paper / "report.html").read_text(encoding="utf-8").replace("</body>", script), encoding="utf-8")
    page = browse(tmp_path, f"--window-size={width},900", "--virtual-time-budget=5000", "--dump-dom", probe.as_uri())
    title = re.search(r"<title>(.*?)</title>", page)
    assert title is not None
    assert title[1] == "images 15 overflow 0"


@pytest.mark.skipif(BROWSER is None, reason="no headless Chromium on PATH")
def test_a_browser_prints_the_report(paper, tmp_path):
    """On landscape A4, every figure with its caption on one page: fewer pages than figures would mean lost ones."""
    place = tmp_path / "report.pdf"
    browse(tmp_path, f"--print-to-pdf={place}", "--no-pdf-header-footer", (paper / "report.html").as_uri())
    content = place.read_bytes()
    assert content.startswith(b"%PDF")
    pages = re.findall(rb"/MediaBox\s*\[\s*0\s+0\s+([\d.]+)\s+([\d.]+)\s*\]", content)
    assert len(PAPER_FIGURES) < len(pages) < 60
    assert all(float(width) > float(height) for width, height in pages)
