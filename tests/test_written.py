"""Measured tables of README.md and docs/ lie in blocks that a command writes, and are as it wrote them."""

import re
from pathlib import Path

import pandas as pd
import pytest

from benchmarks.written import blocks, checked, markdown, outside, write

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
# No target of the Makefile makes these yet: they are of the revision that their comment names.
BY_HAND = {
    "gpu", "nonlinearity", "search-forecast", "search-presets", "search-spline",
}  # fmt: skip


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_measured_tables_are_as_their_command_wrote_them(page):
    assert checked(page) == []
    assert outside(page) == []


def test_every_block_has_a_name_of_its_own_and_a_target_of_the_makefile():
    targets = set(re.findall(r"^([a-z0-9-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    every = [block for page in PAGES for block in blocks(page)]
    names = [block.name for block in every]
    assert len(set(names)) == len(names)
    assert {block.name for block in every if block.command == "no command"} == BY_HAND
    made = [block.command.split()[:2] for block in every if block.name not in BY_HAND]
    assert all(make == "make" and target in targets for make, target in made)


def test_no_comment_is_left_without_its_other_half():
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert text.count("<!-- measured: ") == text.count("<!-- end of ") == len(blocks(page)), page


def test_a_block_is_replaced_alone_and_an_edit_is_seen(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("Before.\n\n<!-- measured: one -->\n<!-- end of one -->\n\nAfter.\n", encoding="utf-8")
    assert checked(page) == ["one"]
    table = markdown(pd.DataFrame({"case": ["a", "b"], "error": ["1.2", "3.4"]}))
    for _ in range(2):
        write(page, "one", table, "make bench")
        assert checked(page) == []
        assert outside(page) == []
    text = page.read_text(encoding="utf-8")
    assert text.startswith("Before.\n\n<!-- measured: one; make bench; revision ")
    assert text.endswith("\n\n<!-- end of one -->\n\nAfter.\n")
    assert blocks(page)[0].text.strip() == table == "| case | error |\n| --- | --- |\n| a | 1.2 |\n| b | 3.4 |"
    for old, new in (("3.4", "3.3"), ("make bench", "make seeds"), ("; 20", "; 19")):
        page.write_text(text.replace(old, new), encoding="utf-8")
        assert checked(page) == ["one"]
    with pytest.raises(LookupError, match="two"):
        write(page, "two", table, "make bench")


def test_a_table_of_numbers_outside_every_block_is_seen(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("| case | error |\n| --- | ---: |\n| 20 DOFs | 1.2 |\n| all | < 3 % |\n", encoding="utf-8")
    assert outside(page) == ["| 20 DOFs | 1.2 |"]
    page.write_text("| key | meaning |\n| --- | --- |\n| `a` | 1 by default |\n", encoding="utf-8")
    assert outside(page) == []
