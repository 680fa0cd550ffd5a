"""The wheel holds what a run needs, and works from any folder of an environment that has never seen this checkout."""

import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest
from calls import SMALL

CHECKOUT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from a copy of the sources, so that the checkout gets no build/."""
    source, place = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
        shutil.copy(CHECKOUT / name, source)
    for name in ("pinn_cli", "conf", "hydra_plugins"):
        shutil.copytree(CHECKOUT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    _pip("wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", str(place), str(source))
    (built,) = place.glob("pinn_cli-*.whl")
    return built


@pytest.fixture(scope="module")
def pinn_run(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The command, installed in a new environment; its dependencies are those of the tests' environment."""
    environment = tmp_path_factory.mktemp("environment")
    venv.create(environment, with_pip=False)
    scripts = environment / ("Scripts" if sys.platform == "win32" else "bin")
    _pip("--python", str(scripts / "python"), "install", "--no-deps", "--no-index", "--no-compile", str(wheel))
    code = "import sysconfig; print(sysconfig.get_paths()['purelib'])"
    packages = Path(subprocess.check_output([scripts / "python", "-c", code], text=True).strip())
    # A path in a .pth file adds the folder but runs none of the folder's own .pth files: the checkout stays out.
    (packages / "dependencies.pth").write_text(sysconfig.get_paths()["purelib"])
    return scripts / "pinn-run"


def _pip(*arguments: str) -> None:
    command = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", *arguments]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_wheel_holds_every_module_config_and_data_file(wheel: Path) -> None:
    held = set(zipfile.ZipFile(wheel).namelist())
    places = (CHECKOUT / "pinn_cli", CHECKOUT / "hydra_plugins")
    modules = {p.relative_to(CHECKOUT).as_posix() for place in places for p in place.rglob("*.py")}
    endings = ("*.csv", "*.yaml", "*.j2", "*.svg", "*.pdf")
    data = {p.relative_to(CHECKOUT).as_posix() for ending in endings for p in (CHECKOUT / "pinn_cli").rglob(ending)}
    configs = {f"pinn_cli/{p.relative_to(CHECKOUT).as_posix()}" for p in (CHECKOUT / "conf").rglob("*.yaml")}
    assert modules | data | configs | {"pinn_cli/py.typed", "pinn_cli/conf/__init__.py"} <= held
    assert not any(name.startswith(("tests/", "conf/", "benchmarks/")) for name in held)


@pytest.mark.slow  # the workflow does so with every Python that is supported
def test_the_installed_command_helps_and_runs_elsewhere(pinn_run: Path, tmp_path: Path) -> None:
    def call(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([pinn_run, *arguments], cwd=tmp_path, capture_output=True, text=True)

    helped = call("--help")
    assert helped.returncode == 0, helped.stderr
    assert "experiment=paper/sr_6dof_perturbed" in helped.stdout
    done = call(*SMALL, "case=installed", "figures=false")
    assert done.returncode == 0, done.stderr
    directory = Path(done.stdout.splitlines()[-1])
    assert directory.is_relative_to(tmp_path / "outputs" / "installed")
    assert (directory / "fitness.csv").is_file()
    assert call("system.ndof=0").returncode == 2


@pytest.mark.slow
def test_the_installed_package_is_the_wheel_s(pinn_run: Path, tmp_path: Path) -> None:
    code = "import pinn_cli, pinn_cli.conf; print(pinn_cli.__file__); print(pinn_cli.conf.__file__)"
    done = subprocess.run(
        [pinn_run.parent / "python", "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    for file in done.stdout.splitlines():
        assert Path(file).is_relative_to(pinn_run.parents[1])
