"""The commands of README.md and docs/, for the tests that pose them and those that run them."""

import importlib.util
import json
import math
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import IntervalSweep
from vibrating_records import wing, wing_record, write_wing

from pinn_cli.model.file import write_model
from pinn_cli.model.knowledge import Levels, Model, ParameterKnowledge
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear

ROOT = Path(__file__).parents[1]
MY_STRUCTURE = ROOT / "docs" / "how-to" / "my-structure.md"
OWN_RECORD = ROOT / "docs" / "how-to" / "own-record.md"
RIG = ROOT / "docs" / "records" / "rig.csv"
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
RUNS = [
    line
    for line in EVERY
    if not re.search(r"--help|\b(resume|collect)=|^pinn-run (inspect|modes|follow|population)", line)
]
FOLLOWED = [line for line in EVERY if line.startswith("pinn-run follow")]
MODAL = [line for line in EVERY if line.startswith("pinn-run modes")]
GALLERY = {line for page in (ROOT / "docs" / "gallery").glob("*.md") for line in commands(page)}  # docs/test_gallery.py
LOOKS = [line for line in EVERY if line.startswith("pinn-run inspect")]

# What takes minutes is cut short, what a command goes through is not; a setting of its own comes later, and holds.
SHORT = {
    r"^(?!.*(figures|paper/))": ("figures=false",),  # docs/test_gallery.py draws them
    r"^(?!.*(data=|model=|experiment=examples|my_rig))": ("simulation.duration=15", "simulation.samples=513"),
    r"simulation\.duration": ("simulation.samples=1025",),
    r"data\.path=rig\.csv(?!.*(stop|until|model=|validation))": ("data.stop=5",),
    r"network=mlp(?!.*(adam|lbfgs))": ("training.iterations=5",),
    r"network=mlp.*(adam|lbfgs)": ("training.iterations=50",),
    r"(scheme=bayesian|paper/pe_)(?!.*laplace)": ("posterior.warmup=20", "posterior.draws=20"),
    r"examples/beam_with_stop": ("simulation.duration=0.5", "simulation.samples=257"),
}


def missing_package(line: str) -> str | None:
    """The package of an extra that a command needs and that is not installed."""
    needed = (package for mark, package in EXTRAS.items() if mark in line)
    return next((package for package in needed if importlib.util.find_spec(package) is None), None)


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


def shortened(arguments: list[str]) -> list[str]:
    """The same of a shorter record, and of a shorter training."""
    return [one for of, ones in SHORT.items() if re.search(of, " ".join(arguments)) for one in ones] + arguments


def blocks(page: Path, language: str) -> list[str]:
    """Fenced blocks of a page in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def write_files(folder: Path) -> None:
    """The records, matrices and configurations that the pages speak of, made by what they show."""
    for script in blocks(MY_STRUCTURE, "python"):
        subprocess.run([sys.executable, "-c", script], cwd=folder, check=True)
    for name in ("rig.csv", "second.csv"):
        shutil.copy(RIG, folder / name)
    rig = pd.read_csv(RIG)
    rig.rename(columns=lambda name: name.replace("a", "u")).to_csv(folder / "quake.csv", index=False)
    for number, places in enumerate((["a3", "a1"], ["a3", "a2"], ["a3", "a1", "a2"]), start=1):
        part = rig[[*(name for name in rig if name not in ("a1", "a2", "a3")), *places]]
        part.to_csv(folder / f"setup_{number}.csv", index=False)
        renamed = part.rename(columns={name: f"ch{i}" for i, name in enumerate(places, start=1)})
        renamed.to_csv(folder / f"logger_{number}.csv", index=False)
    write_wing(wing_record(wing(5, 2, (5.19, 7.3, 9.2)), 5, 12.0), folder / "wing.csv")
    (experiment,) = (block for block in blocks(OWN_RECORD, "yaml") if "case: my_rig" in block)
    (folder / "my_configs" / "experiment").mkdir(parents=True)
    (folder / "my_configs" / "experiment" / "my_rig.yaml").write_text(experiment)


def write_model_run(folder: Path) -> None:
    """runs/january of finished-run.md: a chain of three that somebody has identified."""
    structure = build_chain(3, Linear(), m=5.2, c=15.0, k=40e3)
    own = tuple(replace(p, positive=True) for p in structure.every_parameter() if p.kind != "m")
    mean = np.array([p.prescribed for p in own])
    known = ParameterKnowledge(mean, np.diag(1e-4 * mean**2), 0.0 * mean, 0.0 * mean, mean)
    levels = Levels({}, math.nan, 0.01, math.nan, math.nan)
    directory = folder / "runs" / "january"
    write_model(Model(structure, own, known, levels, None, "sound", ""), directory)
    (directory / "run.json").write_text(json.dumps({"configuration": ""}))
