"""What tests start from: the composed configuration, an empty folder, and global state as it was before any test."""

import gc
import json
import logging
import os
import random
import sys
from collections.abc import Callable, Iterable, Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from calls import Compose, Outcome, PinnRun
from hydra import compose, initialize_config_module
from hydra.core.plugins import Plugins
from hydra.plugins.config_source import ConfigResult, ConfigSource
from omegaconf import DictConfig
from small_estimates import Case, make_estimate

from pinn_cli.cli.command_line import execute
from pinn_cli.main import TASKS, run
from pinn_cli.record.files import file_format
from pinn_cli.runs import histories
from pinn_cli.runs.apart import Answer, UnreadableError
from pinn_cli.settings.errors import InputError
from pinn_cli.system import matrix_files


def pytest_collection() -> None:
    """Have Python look for no garbage while the tests are imported, and never among what they import."""
    gc.disable()


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


@pytest.fixture(autouse=True)
def global_state() -> Iterator[None]:
    """Put back what tests share, generators, threads, environment and logging; forbid a changed default dtype."""
    environment, threads = dict(os.environ), torch.get_num_threads()
    torch_state, python_state = torch.get_rng_state(), random.getstate()
    numpy_state = np.random.get_state()  # noqa: NPY002
    root, package = logging.getLogger(), logging.getLogger("pinn_cli")
    handlers, levels = list(root.handlers), (root.level, package.level)
    yield
    # A run logs to the streams and into the directory of its test, which go with it.
    for handler in [handler for handler in root.handlers if handler not in handlers]:
        root.removeHandler(handler)
        if isinstance(handler, logging.FileHandler):
            handler.close()
    root.setLevel(levels[0])
    package.setLevel(levels[1])
    os.environ.clear()
    os.environ.update(environment)
    torch.set_num_threads(threads)
    torch.set_rng_state(torch_state)
    np.random.set_state(numpy_state)  # noqa: NPY002
    random.setstate(python_state)
    assert torch.get_default_dtype() == torch.float32, "the test changed torch's default dtype"


@pytest.fixture(autouse=True, scope="session")
def shipped_files_parsed_once() -> Iterator[None]:
    """Of the time that Hydra takes for a configuration, a third went into parsing some twenty shipped files anew."""
    (source,) = (each for each in Plugins.instance().discover(ConfigSource) if each.scheme() == "pkg")
    parse, parsed = source.load_config, dict[tuple[str, str], ConfigResult]()

    def load_config(self: ConfigSource, config_path: str) -> ConfigResult:
        place = self.path, config_path
        if place not in parsed:
            parsed[place] = parse(self, config_path)
        return deepcopy(parsed[place])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(source, "load_config", load_config)
        yield


@pytest.fixture(scope="session")
def shared() -> Path:
    """The reference data that is kept beside the repository."""
    root = Path(__file__).parents[1]
    for folder in (root.parent / "shared", root / "shared"):
        if (folder / "data").is_dir():
            return folder
    pytest.skip("the reference data (../shared) is not here")


@pytest.fixture(scope="session")
def make_case() -> Callable[..., Case]:
    """A small estimate, its record and its truth."""
    return make_estimate


def read_here(read: Callable[..., Iterable[Answer]], question: list[Any], *_: object) -> Iterator[Answer]:
    """What :func:`pinn_cli.runs.apart.read_apart` answers, from this process: a new one imports for a second."""
    try:
        for plain, arrays in read(*json.loads(json.dumps(question))):
            yield json.loads(json.dumps(plain)), list(map(np.array, arrays))
    except InputError:
        raise
    except Exception as error:
        raise UnreadableError(str(error).strip().partition("\n")[0] or type(error).__name__) from None


@pytest.fixture(autouse=True)
def files_read_here(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Quick tests read files in this process, but for those about what a file does to a process of its own."""
    if not any(map(request.node.get_closest_marker, ("apart", "slow"))):
        for reader in (file_format, histories, matrix_files):
            monkeypatch.setattr(reader, "read_apart", read_here)


@pytest.fixture
def composed() -> Compose:
    """Compose the shipped configuration under overrides, as the command line does."""

    def compose_with(*overrides: str) -> DictConfig:
        with initialize_config_module("pinn_cli.conf", version_base="1.3"):
            return compose("config", overrides=list(overrides))

    return compose_with


@pytest.fixture
def pinn_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> PinnRun:
    """Call `pinn-run` with these arguments in this process, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("HYDRA_FULL_ERROR", raising=False)

    def call(*arguments: str, task: Callable[[DictConfig], None] = run) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["pinn-run", *arguments])
        capfd.readouterr()
        try:
            status = execute(task, TASKS)
        except SystemExit as end:
            status = int(end.code or 0)
        captured = capfd.readouterr()
        return Outcome(status, captured.out, captured.err)

    return call
