"""`make docs`, and what its pages are made of: examples of docstrings, settings with their defaults."""

import doctest
import functools
import importlib
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from pinn_cli.cli.schema import STRUCTURE, Setting, explained

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs" / "extensions"))

from settings_tables import CONF, GROUPS  # noqa: E402

RECIPE = re.search(r"^docs:.*\n\t\$\(BIN\)/python (.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)


def build(source: Path, pages: Path) -> subprocess.CompletedProcess[str]:
    """What `make docs` does, from and into these folders."""
    assert RECIPE
    arguments = [{"docs": str(source), "build/docs": str(pages)}.get(word, word) for word in RECIPE[1].split()]
    assert {str(source), str(pages), "-W"} <= set(arguments)
    return subprocess.run([sys.executable, *arguments], cwd=ROOT, capture_output=True, text=True)


@pytest.mark.slow
def test_every_page_is_built_and_needs_nothing_from_elsewhere(tmp_path: Path) -> None:
    done = build(ROOT / "docs", tmp_path)
    assert done.returncode == 0, done.stderr
    pages = {file.relative_to(tmp_path).as_posix(): file.read_text("utf-8") for file in tmp_path.rglob("*.html")}
    files = [file.relative_to(ROOT / "docs") for file in (ROOT / "docs").rglob("*.md")]
    sources = {file.with_suffix(".html") for file in files if "joss" not in file.parts}  # the article of a journal
    assert {source.as_posix() for source in sources} <= set(pages)
    for name, html in pages.items():
        loaded = re.findall(r"<(?:script|link|img|iframe)\b[^>]*?\b(?:src|href)=\"([^\"]+)\"", html)
        assert not [address for address in loaded if re.match(r"(?:https?:)?//", address)], name
    # Equations need no script.
    assert pages["method.html"].count("<math ") > 5
    assert '<mover accent="true">' not in pages["method.html"]  # Chromium draws dots into letters then
    assert '<mo stretchy="false">¨</mo>' in pages["method.html"]
    # Classes are told by their docstrings.
    for name in ("pinn_cli.system.connection.nonlinearity.Nonlinearity", "pinn_cli.scheme.scheme.Scheme"):
        assert f'id="{name}"' in pages["reference/python.html"]
    assert "Raises" in pages["reference/python.html"]


@pytest.mark.slow
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


def test_examples_of_docstrings_do_what_they_say() -> None:
    files = [f for f in sorted((ROOT / "pinn_cli").rglob("*.py")) if ">>> " in f.read_text(encoding="utf-8")]
    assert files
    for file in files:
        module = importlib.import_module(".".join(file.relative_to(ROOT).with_suffix("").parts))
        outcome = doctest.testmod(module)
        assert (bool(outcome.attempted), outcome.failed) == (True, 0), file


FILES = [CONF / "config.yaml", *(file for group in GROUPS for file in sorted((CONF / group).glob("*.yaml")))]


def leaves(node: dict[str, object], prefix: str = "") -> Iterator[tuple[str, object]]:
    """Names and values of a file's settings."""
    for name, value in node.items():
        if name not in STRUCTURE:
            if isinstance(value, dict) and value:
                yield from leaves(value, f"{prefix}{name}.")
            else:
                yield f"{prefix}{name}", value


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.relative_to(CONF).as_posix())
def test_every_setting_is_read_with_its_default(file: Path) -> None:
    content = yaml.safe_load(file.read_text(encoding="utf-8")) or {}
    found = {setting.name: setting.default for setting in explained(file).settings}
    wanted = dict(leaves(content))
    # A map on one line is one setting.
    assert {name for name in wanted if not any(name.startswith(f"{one}.") and found[one] for one in found)} <= set(
        found
    )
    for name, default in found.items():
        if default:
            assert yaml.safe_load(default) == functools.reduce(dict.__getitem__, name.split("."), content), name


def test_groups_are_those_of_conf() -> None:
    folders = {folder.name for folder in CONF.iterdir() if folder.is_dir() and not folder.name.startswith("__")}
    assert folders - {"demonstration", "experiment"} == {group.partition("/")[0] for group in GROUPS}


def test_comments_and_commands(tmp_path: Path) -> None:
    file = tmp_path / "some.yaml"
    file.write_text(
        "# What it is.\n#   pinn-run some=one\n_target_: a.B\nname: null   # m; null:\n           # inferred\n"
        "group:           # of all below\n  first: '#1'\n  _target_: c.D\n  second: {a: 1}  # s\n"
        "last: 2\n# no comment of last\n"
    )
    found = explained(file)
    assert (found.title, found.commands, found.target) == ("What it is.", ["pinn-run some=one"], "a.B")
    assert found.settings == [
        Setting("name", "null", "m; null: inferred"),
        Setting("group", "", "of all below"),
        Setting("group.first", "'#1'", ""),
        Setting("group.second", "{a: 1}", "s"),
        Setting("last", "2", ""),
    ]
