"""docs/extensions/settings_tables.py: the page has every setting of conf/ with the default that a run has."""

import functools
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs" / "extensions"))

from settings_tables import CONF, GROUPS  # noqa: E402

from pinn_cli.cli.schema import STRUCTURE, Setting, explained  # noqa: E402

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
