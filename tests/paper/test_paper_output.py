"""What `make paper` leaves behind: tables in three formats, figures and one report, from made-up runs."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import pandas as pd
import pytest

from pinn_cli.paper.__main__ import main
from pinn_cli.paper.commands import make_figures, make_paper, make_table
from pinn_cli.paper.figures import copy_figures, paper_figures
from pinn_cli.paper.runs import CaseFailedError
from pinn_cli.paper.sheet import Row, Sheet, number
from pinn_cli.paper.shortfalls import fitness_reason, parameter_reason
from pinn_cli.paper.symbols import written

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
    assert checked.count["img"] == len(paper_figures()) + 1 == 15
    assert [place.partition(";")[0] for place in checked.loaded] == ["data:image/svg+xml"] * 3 + ["data:image/png"] * 12
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


def test_every_figure_as_a_picture_for_screens_and_one_for_print(paper):
    names = {f"figure{number:02d}.{'svg' if number < 4 else 'png'}" for number in range(1, 15)}
    names |= {f"figure{number:02d}.pdf" for number in range(1, 15)}
    assert {file.name for file in (paper / "figures").iterdir()} == names
    starts = {".png": b"\x89PNG", ".pdf": b"%PDF", ".svg": b"<?xml"}
    assert all(file.read_bytes().startswith(starts[file.suffix]) for file in (paper / "figures").iterdir())


def test_figures_are_those_of_their_runs(paper):
    run = paper / "runs" / "sr_20dof_snr50_uncertain" / "figures"
    assert (paper / "figures" / "figure06.png").read_bytes() == (run / "error_map.png").read_bytes()


@pytest.mark.usefixtures("quick_digests")
def test_figures_alone_need_only_their_runs(tmp_path, runner):
    assert make_figures(tmp_path, runner) == 0
    assert len(runner.calls) == len({figure.run for figure in paper_figures() if figure.run}) == 10
    assert not (tmp_path / "report.html").exists()


@pytest.mark.usefixtures("quick_digests")
@pytest.mark.parametrize(("table", "count"), [("table1", 1), ("table2", 12), ("table3", 6), ("table6", 6)])
def test_a_table_alone_needs_only_its_runs(tmp_path, runner, capsys, table, count):
    assert make_table(table, tmp_path, runner) == 0
    assert len(runner.calls) == count
    assert {file.name for file in (tmp_path / "tables").iterdir()} == {
        f"{table}.{form}" for form in ("csv", "md", "tex")
    }
    assert (tmp_path / "tables" / f"{table}.md").read_text() in capsys.readouterr().out
    assert not (tmp_path / "report.html").exists()


@pytest.mark.usefixtures("quick_digests")
def test_a_table_tells_of_the_case_that_failed(tmp_path, runner, capsys):
    runner.failing = {"sp_5dof_linear": CaseFailedError("sp_5dof_linear, fixed parameters: exit status 1")}
    assert make_table("table4", tmp_path, runner) == 1
    assert set(pd.read_csv(tmp_path / "tables" / "table4.csv")["case"]) == {"sp_5dof_van_der_pol", "sp_5dof_perturbed"}
    assert "sp_5dof_linear, fixed parameters: exit status 1" in capsys.readouterr().err


@pytest.mark.usefixtures("quick_digests")
def test_a_failed_case_leaves_a_gap_that_the_report_tells(tmp_path, runner):
    runner.failing = {"sr_20dof_snr50": CaseFailedError("sr_20dof_snr50, fixed parameters: exit status 3")}
    assert make_paper(tmp_path, runner) == 1
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "exit status 3" in text
    assert "Not drawn: the run sr_20dof_snr50_uncertain is missing" in text
    Checked(text)


@pytest.mark.usefixtures("quick_digests")
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


def test_a_figure_of_a_run_needs_it(tmp_path):
    assert list(copy_figures({}, tmp_path)) == [1, 2, 3]


def test_an_interrupt_ends_with_130(tmp_path, monkeypatch, capsys):
    def interrupted(*_, at_once):
        raise KeyboardInterrupt

    monkeypatch.setattr("pinn_cli.paper.commands.make_runs", interrupted)
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
    assert len(paper_figures()) < len(pages) < 60
    assert all(float(width) > float(height) for width, height in pages)
