"""What README.md and docs/ name is there: pages, headings, modules, files, make targets, options and settings."""

import importlib.util
import re
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from pinn_cli.settings.instantiation import PLUGINS

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
SETTINGS = (ROOT / "docs" / "reference" / "settings.md").read_text(encoding="utf-8")
FENCED = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
# Groups that a person does not choose from, or that have a page of their own.
OTHER_GROUPS = {"demonstration", "experiment", "hydra"}


def text(page):
    return page.read_text(encoding="utf-8")


def anchor(heading):
    """As GitHub makes it."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


def anchors(page):
    return {anchor(heading) for heading in re.findall(r"^#+ (.*)$", FENCED.sub("", text(page)), re.MULTILINE)}


def links(page):
    found = re.findall(r"\]\(([^)\s]+)\)", FENCED.sub("", text(page)))
    return [link for link in found if not link.startswith(("http://", "https://"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page):
    for link in links(page):
        name, _, heading = link.partition("#")
        target = (page.parent / name).resolve() if name else page
        assert target.is_file(), link
        assert not heading or heading in anchors(target), link


def test_every_page_stands_in_the_contents():
    """Of the site; a page that is not in README either is found there, through docs/index.md."""
    index = ROOT / "docs" / "index.md"
    pages = {page for page in (ROOT / "docs").rglob("*.md") if page.parent.name != "joss"}
    named = {
        page.parent / f"{line}.md"
        for page in pages
        for block in re.findall(r"^```\{toctree\}\n(.*?)^```", text(page), re.MULTILINE | re.DOTALL)
        for line in block.splitlines()
        if line and not line.startswith(":")
    }
    assert pages - {index} == named
    assert index in {(ROOT / link.partition("#")[0]).resolve() for link in links(PAGES[0])}


def test_readme_is_short():
    assert len(text(PAGES[0]).splitlines()) <= 100


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_files_and_modules_exist(page):
    made = set(re.findall(r"^# ((?:pinn_cli|conf)/\S+)", text(page), re.MULTILINE))  # those that a page says to write
    modules = {file.removesuffix(".py").replace("/", ".") for file in made}
    for name in set(re.findall(r"\b(?:conf|pinn_cli)/[\w/]+\.(?:yaml|py)\b", text(page))) - made:
        assert (ROOT / name).is_file(), name
    for name in set(re.findall(r"`((?:conf|pinn_cli|tests|benchmarks)/[\w/]*/)`", text(page))):
        assert (ROOT / name).is_dir(), name
    for name in set(re.findall(r"\bpinn_cli(?:\.\w+)+", text(page))):
        # A class, or an attribute of one, follows the module.
        module = re.sub(r"\.[A-Z].*", "", name)
        if module not in modules and module != PLUGINS:
            assert importlib.util.find_spec(module), name


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_make_targets_exist(page):
    targets = set(re.findall(r"^([a-z0-9-]+):", text(ROOT / "Makefile"), re.MULTILINE))
    named = re.findall(r"`make ([a-z0-9-]+)", text(page)) + re.findall(r"^make ([a-z0-9-]+)", text(page), re.MULTILINE)
    assert set(named) <= targets


def test_every_option_stands_in_the_reference():
    groups = [folder for folder in (ROOT / "conf").iterdir() if folder.is_dir() and folder.name not in OTHER_GROUPS]
    options = {f"{group.name}={file.stem}" for group in groups for file in group.glob("[!_]*.yaml")}
    options |= {f"hydra/launcher={file.stem}" for file in (ROOT / "conf" / "hydra" / "launcher").glob("*.yaml")}
    named = set(re.findall(r"`((?:hydra/)?[a-z_]+=[a-z_0-9]+)`", SETTINGS))
    chosen = {name for name in named if name.partition("=")[0] in {option.partition("=")[0] for option in options}}
    assert options <= named
    assert chosen - options <= {"hydra/launcher=joblib", "network=fine"}


def test_every_general_setting_stands_in_the_reference():
    config = OmegaConf.load(ROOT / "conf" / "config.yaml")
    for name, value in config.items():
        if name not in ("defaults", "hydra"):
            for setting in [f"{name}.{key}" for key in value] if OmegaConf.is_config(value) else [name]:
                assert f"`{setting}`" in SETTINGS, setting
