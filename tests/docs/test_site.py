"""`make docs`: the pages build without a warning (a link that leads nowhere is one), and need no network to be read."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]
RECIPE = re.search(r"^docs:.*\n\t\$\(BIN\)/python (.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)


def build(source: Path, pages: Path) -> subprocess.CompletedProcess[str]:
    """What `make docs` does, from and into these folders."""
    assert RECIPE
    arguments = [{"docs": str(source), "build/docs": str(pages)}.get(word, word) for word in RECIPE[1].split()]
    assert {str(source), str(pages), "-W"} <= set(arguments)
    return subprocess.run([sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True)


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """HTML by the page's name."""
    place = tmp_path_factory.mktemp("site")
    done = build(ROOT / "docs", place)
    assert done.returncode == 0, done.stderr
    return {file.relative_to(place).as_posix(): file.read_text(encoding="utf-8") for file in place.rglob("*.html")}


def test_every_page_is_built(pages: dict[str, str]) -> None:
    files = [file.relative_to(ROOT / "docs") for file in (ROOT / "docs").rglob("*.md")]
    sources = {file.with_suffix(".html") for file in files if "joss" not in file.parts}  # the article of a journal
    assert {source.as_posix() for source in sources} <= set(pages)


def test_a_page_loads_nothing_from_elsewhere(pages: dict[str, str]) -> None:
    for name, html in pages.items():
        loaded = re.findall(r"<(?:script|link|img|iframe)\b[^>]*?\b(?:src|href)=\"([^\"]+)\"", html)
        assert not [address for address in loaded if re.match(r"(?:https?:)?//", address)], name


def test_equations_need_no_script(pages: dict[str, str]) -> None:
    assert pages["method.html"].count("<math ") > 5
    assert '<mover accent="true">' not in pages["method.html"]  # Chromium draws dots into letters then
    assert '<mo stretchy="false">¨</mo>' in pages["method.html"]


def test_classes_are_told_by_their_docstrings(pages: dict[str, str]) -> None:
    html = pages["reference/python.html"]
    for name in ("pinn_cli.system.connection.nonlinearity.Nonlinearity", "pinn_cli.scheme.scheme.Scheme"):
        assert f'id="{name}"' in html
    assert "Raises" in html


def test_a_broken_link_fails(tmp_path: Path) -> None:
    source = tmp_path / "docs"
    source.mkdir()
    settings = (ROOT / "docs" / "conf.py").read_text(encoding="utf-8")
    settings = settings.replace("Path(__file__).parent\n", f"Path({str(ROOT / 'docs')!r})\n").replace('"_static"', "")
    (source / "conf.py").write_text(settings)
    (source / "index.md").write_text("# One page\n\n[A heading](#one-page) and [no heading](#no-page)\n")
    done = build(source, tmp_path / "pages")
    assert done.returncode != 0
    assert "no-page" in done.stderr
    assert done.stderr.count("WARNING") == 1
