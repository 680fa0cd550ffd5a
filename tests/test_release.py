"""What a release is made of agrees with pyproject.toml, the one place of the version and of what is needed."""

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import jinja2
import pytest
import yaml

ROOT = Path(__file__).parents[1]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
DOCKERFILE = (ROOT / "Dockerfile").read_text(encoding="utf-8")
# PyPI's name: conda-forge's.
CONDA_NAMES = {"torch": "pytorch", "matplotlib": "matplotlib-base"}


def load(name: str) -> Any:
    return yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))


def name_and_range(requirement: str) -> tuple[str, str]:
    parts = re.fullmatch(r"([\w.-]+)\s*(.*)", requirement)
    assert parts
    return parts[1].lower(), parts[2]


@pytest.fixture(scope="module")
def recipe() -> dict[str, Any]:
    """recipe/meta.yaml as conda-build renders it."""

    def load_file_data(name: str, from_recipe_dir: bool) -> Any:
        assert from_recipe_dir
        return tomllib.loads((ROOT / "recipe" / name).read_text(encoding="utf-8"))

    template = jinja2.Template((ROOT / "recipe" / "meta.yaml").read_text(encoding="utf-8"))
    return yaml.safe_load(template.render(load_file_data=load_file_data, PYTHON="python"))


def test_the_citation_has_the_version() -> None:
    assert load("CITATION.cff")["version"] == PROJECT["version"]


def test_no_change_is_listed_under_a_version_to_come() -> None:
    headings = re.findall(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert headings[0] == "Unreleased"
    versions = [tuple(map(int, heading.split("."))) for heading in headings[1:]]
    assert versions == sorted(versions, reverse=True)
    assert all(version <= tuple(map(int, PROJECT["version"].split("."))) for version in versions)


def test_the_recipe_needs_what_the_package_needs(recipe: dict[str, Any]) -> None:
    assert recipe["package"] == {"name": PROJECT["name"], "version": PROJECT["version"]}
    needed = dict(map(name_and_range, PROJECT["dependencies"]))
    wanted = {CONDA_NAMES.get(name, name): versions for name, versions in needed.items()}
    wanted["python"] = PROJECT["requires-python"]
    assert dict(map(name_and_range, recipe["requirements"]["run"])) == wanted


def test_the_recipe_makes_the_command(recipe: dict[str, Any]) -> None:
    assert recipe["build"]["entry_points"] == [f"{name} = {place}" for name, place in PROJECT["scripts"].items()]
    assert (ROOT / "recipe" / recipe["source"]["path"] / recipe["about"]["license_file"]).is_file()


def test_the_image_copies_what_is_there_and_needed() -> None:
    copied = re.findall(r"^COPY (?!--)(.*) \S+$", DOCKERFILE, re.MULTILINE)
    for name in " ".join(copied).split():
        assert (ROOT / name).exists(), name
    ignored = (ROOT / ".dockerignore").read_text(encoding="utf-8").split()
    assert not {"pinn_cli", "conf", "hydra_plugins", "tests", "Makefile"} & set(ignored)


def test_the_image_runs_the_command_and_the_targets() -> None:
    (command,) = re.findall(r"^ENTRYPOINT (.*)$", DOCKERFILE, re.MULTILINE)
    assert json.loads(command)[0] in PROJECT["scripts"]
    (make, target) = json.loads(re.findall(r"^CMD (.*)$", DOCKERFILE, re.MULTILINE)[0])
    assert make == "make"
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)


def test_versions_of_python_agree() -> None:
    lowest, below = map(int, re.findall(r"3\.(\d+)", PROJECT["requires-python"]))
    tried = load(".github/workflows/ci.yml")["jobs"]["wheel"]["strategy"]["matrix"]["python"]
    assert tried == [f"3.{minor}" for minor in range(lowest, below)]
    (image,) = re.findall(r"^ARG PYTHON=(.*)$", DOCKERFILE, re.MULTILINE)
    assert image in tried
