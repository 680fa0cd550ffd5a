"""docs/gallery/: every example has a command, what it prints, and a figure that it drew."""

import math
import re
from collections.abc import Callable
from pathlib import Path
from unittest.mock import MagicMock

import pytest
from PIL import Image

from benchmarks.gallery import GALLERY, all_pages, commands, figures, pages, performed, quoted_output
from pinn_cli import load

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?$")


def alike(quoted: str, printed: str) -> bool:
    """Whether a line begins with what a page quotes, numbers to some per cent: machines differ in the last digits."""
    words, others = (re.sub(r"[(),;]", " ", line).split() for line in (quoted, printed))
    return len(words) <= len(others) and all(
        math.isclose(float(a), float(b), rel_tol=0.05, abs_tol=0.05) if NUMBER.match(a) and NUMBER.match(b) else a == b
        for a, b in zip(words, others, strict=False)
    )


def test_there_are_twelve_examples_and_the_index_shows_a_figure_of_each() -> None:
    index = (GALLERY / "index.md").read_text(encoding="utf-8")
    listed = re.findall(r"\]\((\w[\w-]*)\.md\)", index)
    assert sorted(set(listed)) == [page.stem for page in pages()]
    assert len(listed) >= 12
    shown = re.findall(r"\[!\[[^]]+\]\((figures/[\w-]+\.png)\)\]\(([\w-]+)\.md\)", index)
    assert {page: GALLERY / figure for figure, page in shown} == {
        page.stem: next(iter(figures(page))) for page in pages()
    }
    shown = {file for page in all_pages() for file in figures(page)}
    assert shown == set((GALLERY / "figures").glob("*.png"))


@pytest.mark.parametrize("page", all_pages(), ids=lambda page: page.stem)
def test_an_example_has_a_figure_and_quotes_its_run(page: Path) -> None:
    assert commands(page)
    assert quoted_output(page)
    assert figures(page)
    for file in figures(page):
        with Image.open(file) as image:
            assert image.width > 300


def in_python(page: Path, run: Callable[..., object]) -> None:
    """Do what the page shows in Python, with this for `run`."""
    for block in re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL):
        exec(block.replace("from pinn_cli import run", ""), {"run": run})


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.stem)
def test_the_command_and_python_are_given_the_same(page: Path) -> None:
    given = []

    def run(*overrides: str, multirun: bool = False) -> MagicMock:
        given.append([*(["--multirun"] if multirun else []), *overrides])
        return MagicMock()

    in_python(page, run)
    # A look has no function in Python.
    assert given == [command for command in commands(page) if command[0] != "inspect"]


@pytest.mark.slow
@pytest.mark.parametrize("page", all_pages(), ids=lambda page: page.stem)
def test_an_example_prints_what_its_page_quotes(page: Path, tmp_path: Path) -> None:
    printed, directory = performed(page, tmp_path)
    lines = printed.splitlines()
    for quoted in quoted_output(page):
        assert any(alike(quoted, line) for line in lines), quoted
    for name in figures(page).values():
        assert (directory / "figures" / name).is_file()
    in_python(page, lambda *overrides, **options: load(directory))
