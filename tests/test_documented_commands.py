"""Every command of README.md and docs/ is accepted: composed, validated, and posed up to the first step of training."""

from __future__ import annotations

import importlib.util
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hydra import compose, initialize_config_module
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import IntervalSweep

from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.inspecting import Inspected
from pinn_cli.inspection.inspection import inspect_record
from pinn_cli.training.band.evidence import Evidence
from pinn_cli.training.estimate import RunContext
from pinn_cli.training.function_space import training as over_all_weights
from pinn_cli.training.gradient import training as gradient_training

ROOT = Path(__file__).parents[1]
MY_STRUCTURE = ROOT / "docs" / "how-to" / "my-structure.md"
OWN_RECORD = ROOT / "docs" / "how-to" / "own-record.md"
# What extending.md shows runs in test_extending.py.
PAGES = [ROOT / "README.md", *sorted(set((ROOT / "docs").rglob("*.md")) - {ROOT / "docs" / "extending.md"})]
FENCED = re.compile(r"^```\w*\n(.*?)^```", re.MULTILINE | re.DOTALL)
# Packages of extras that a command needs.
EXTRAS = {"tracking=mlflow": "mlflow", "tracking=tensorboard": "tensorboard", "launcher=slurm": "submitit"}
EXTRAS |= {"launcher=ray": "ray", "sweeper=search": "optuna", "experiment=search": "optuna", "search/": "optuna"}


def commands(page: Path) -> Iterator[str]:
    """Those in fenced blocks, continued lines put together."""
    for block in FENCED.findall(page.read_text(encoding="utf-8")):
        for line in block.replace("\\\n", " ").splitlines():
            if line.startswith("pinn-run "):
                yield line


EVERY = sorted(
    {" ".join(shlex.split(line, comments=True)[1:]): line for page in PAGES for line in commands(page)}.values()
)
RUNS = [line for line in EVERY if not re.search(r"--help|\b(resume|collect)=|^pinn-run inspect", line)]
LOOKS = [line for line in EVERY if line.startswith("pinn-run inspect")]


class TrainingBeginsError(Exception):
    """Nothing has refused the command."""


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A folder with the files and the configuration that own-record.md and my-structure.md speak of."""
    time = 0.01 * np.arange(400)
    columns = {name: np.sin((3 + i) * time) + np.cos(11 * time) for i, name in enumerate(("f1", "a1", "a3"))}
    pd.DataFrame({"t": np.round(time, 2), **columns}).to_csv(tmp_path / "rig.csv", index=False)
    blocks = re.findall(r"^```yaml\n(.*?)^```", OWN_RECORD.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    (experiment,) = (block for block in blocks if "case: my_rig" in block)
    (tmp_path / "my_configs" / "experiment").mkdir(parents=True)
    (tmp_path / "my_configs" / "experiment" / "my_rig.yaml").write_text(experiment)
    monkeypatch.chdir(tmp_path)
    (script,) = re.findall(r"^```python\n(.*?)^```", MY_STRUCTURE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    exec(script, {})
    return tmp_path


@pytest.fixture(autouse=True)
def no_work(monkeypatch: pytest.MonkeyPatch) -> None:
    def begins(*arguments: object, **settings: object) -> None:
        raise TrainingBeginsError

    monkeypatch.setattr(over_all_weights, "train", begins)
    monkeypatch.setattr(gradient_training, "train", begins)
    monkeypatch.setattr(Evidence, "train", begins)


def first_job(arguments: list[str]) -> list[str]:
    """The overrides of a sweep's first job; of any other run its own."""
    out = []
    for override in OverridesParser.create().parse_overrides(arguments):
        text = override.input_line or ""
        if override.is_sweep_override():
            value = override.value()
            first = value.start if isinstance(value, IntervalSweep) else next(override.sweep_string_iterator())
            text = f"{override.get_key_element()}={first}"
        # The command line has a map's keys added, and these tests have no GPU.
        out.append(re.sub(r"^(?=[\w.]+=\{)", "++", text).replace("device=cuda", "device=cpu"))
    return out


@pytest.mark.parametrize("line", RUNS)
def test_a_documented_run_gets_as_far_as_training(line: str, rig: Path) -> None:
    for mark, package in EXTRAS.items():
        if mark in line and importlib.util.find_spec(package) is None:
            pytest.skip(f"{package} is not installed")
    arguments = [argument for argument in shlex.split(line, comments=True)[1:] if argument != "--multirun"]
    while "--config-dir" in arguments:
        place = arguments.index("--config-dir")
        arguments[place : place + 2] = [f"hydra.searchpath=[file://{rig / arguments[place + 1]}]"]
    with initialize_config_module("pinn_cli.conf", version_base="1.3"):
        composed = compose("config", overrides=first_job(arguments))
    config = RunConfig.read(composed, rig)
    record = config.observe(config.source.measure(config.model_error.structures(config.structure)[0]).record)
    problem = config.scheme.problem(config.model_error.structures(config.structure)[1], record)
    with pytest.raises(TrainingBeginsError):
        config.estimator.solve(problem, RunContext())


@pytest.mark.parametrize("line", LOOKS)
def test_a_documented_look_is_had(line: str, rig: Path) -> None:
    with initialize_config_module("pinn_cli.conf", version_base="1.3"):
        composed = compose("config", overrides=first_job(shlex.split(line)[2:]))
    looked_at = Inspected.read(composed, rig)
    assert inspect_record(looked_at.signals, looked_at.time, [], looked_at.frequencies).command


def test_there_are_commands_to_test() -> None:
    assert len(RUNS) > 25
    others = [line for line in EVERY if line not in (*RUNS, *LOOKS)]
    assert all(re.search(r"pinn-run (--help|(resume|collect)=\S+)( +#.*)?$", line) for line in others), others
