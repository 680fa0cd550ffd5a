"""Stand-ins for runs and for network and smoother: results made up from the published values."""

from __future__ import annotations

from functools import cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
import pytest
from matplotlib.figure import Figure

from pinn_cli.paper.__main__ import make_nonlinearity, make_paper, make_seeds
from pinn_cli.record.response import QUANTITIES
from pinn_cli.report.fitness import published
from pinn_cli.runs.writing import write_json, write_table
from pinn_cli.settings.errors import InputError

if TYPE_CHECKING:
    from pinn_cli.paper.realisations import Realisation
    from pinn_cli.paper.runs import PlannedRun

SECONDS = {"estimate": 2.0, "baseline": 1.0, "total": 4.0}
SOLVED = {"record": 0.5, "estimate": 1.0, "baseline": 1.0, "total": 2.5}
PICTURES = ("response", "error_map", "posterior_pairs")
# Read once: a study asks for them hundreds of times.
published_fitness, published_parameters = cache(lambda: published("fitness")), cache(lambda: published("parameters"))


def _fitness(case: str, estimator: str, offset: float) -> pd.DataFrame:
    """Range fitness is so much above the published one; that by the printed formula is 5 less."""
    table = published_fitness()
    cells = table.loc[table["case"] == case, ["group", "quantity", "fitness_percent"]]
    if cells.empty:  # the Bayesian cases and those of other chains have no published fitness
        cells = pd.DataFrame({"group": "all", "quantity": QUANTITIES, "fitness_percent": 97.0})
    ranged = cells["fitness_percent"] + offset
    return cells.assign(estimator=estimator, range_fitness_percent=ranged, fitness_percent=ranged - 5.0)


def _parameters(case: str, estimator: str, error_percent: float) -> pd.DataFrame:
    table = published_parameters()
    table = table.loc[table["case"] == case, ["parameter", "true"]]
    if case == "sr_6dof_perturbed":
        table = published("perturbed_parameters")[["parameter", "true"]]
    estimate, std = table["true"] * (1.0 + error_percent / 100.0), 0.01 * table["true"]
    return table.assign(
        estimator=estimator, estimate=estimate, error_percent=error_percent, std=std, lower_90=estimate - 2.0 * std,
        upper_90=estimate + 2.0 * std,
    )  # fmt: skip


@cache
def _picture(name: str, ending: str) -> bytes:
    """What stands for a figure of a run."""
    file, figure = BytesIO(), Figure(figsize=(4.0, 1.0))
    figure.text(0.5, 0.5, name)
    figure.savefig(file, format=ending)
    return file.getvalue()


class FakeRunner:
    """Leaves behind what a run leaves; `calls` are those made.

    Ours is better than the published values by `offset` and the smoother half as much; the cases in `failing` raise
    that instead.
    """

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.failing: dict[str, BaseException] = {}
        self.offset = 0.2

    def __call__(self, run: PlannedRun, directory: Path) -> float:
        case = run.case
        if case in self.failing:
            raise self.failing[case]
        self.calls.append(directory.name)
        offsets = {"pinn": self.offset}
        if "baseline=kalman_smoother" in run.overrides and not case.startswith("pe_"):
            offsets["kalman_smoother"] = self.offset / 2.0
        fitness = pd.concat([_fitness(case, name, offset) for name, offset in offsets.items()])
        parameters = pd.concat([_parameters(case, name, 1.0 - offset) for name, offset in offsets.items()])
        write_table(fitness, directory / "fitness.csv")
        write_table(parameters, directory / "parameters.csv")
        write_json({"seconds": SECONDS}, directory / "run.json")
        if run.variant.name in ("uncertain", "marginal"):
            (directory / "figures").mkdir(exist_ok=True)
            for file in [f"{name}.{ending}" for name in PICTURES for ending in ("png", "pdf")]:
                (directory / "figures" / file).write_bytes(_picture(*file.split(".")))
        return 5.0


class FakeSolver:
    """Range fitness is the published value plus 0.2, and 0.1 less with each seed; the smoother's is 0.05 less.

    `diverging` realisations have no rows, `refused` ones raise; `interrupted_after` so many calls the user interrupts.
    """

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.diverging: set[str] = set()
        self.refused: set[str] = set()
        self.interrupted_after: int | None = None

    def __call__(self, one: Realisation) -> dict[str, Any]:
        if self.interrupted_after is not None and len(self.calls) >= self.interrupted_after:
            raise KeyboardInterrupt
        self.calls.append(one.name)
        if one.name in self.refused:
            raise InputError("system.kappa", -1, ">= 0")
        found = {"fitness": [], "parameters": [], "seconds": SOLVED, "strength": 3.0, "failure": "loss is not finite"}
        if one.name in self.diverging:
            return found
        case = one.name.rpartition("_seed")[0]
        scored = [self._scored(one, case, name, lag) for name, lag in (("pinn", 0.0), ("kalman_smoother", 0.05))]
        fitness, parameters = (pd.concat(tables).to_dict("records") for tables in zip(*scored, strict=True))
        strength = dict(one.columns).get("kappa", 0.0) / 1000.0
        return found | {"fitness": fitness, "parameters": parameters, "strength": strength, "failure": ""}

    def _scored(self, one: Realisation, case: str, estimator: str, lag: float) -> tuple[pd.DataFrame, pd.DataFrame]:
        labels = {"case": case, "seed": one.seed, "model_error": case.partition("_")[0]}
        fitness = _fitness(case, estimator, 0.2 - 0.1 * one.seed - lag)
        return fitness.assign(**labels), _parameters(case, estimator, 1.0 + 100.0 * lag).assign(**labels)


@pytest.fixture
def runner() -> FakeRunner:
    return FakeRunner()


@pytest.fixture
def solver() -> FakeSolver:
    return FakeSolver()


def make_quick(patch: pytest.MonkeyPatch) -> None:
    """Small studies, and no true digests, which have tests of their own."""
    patch.setattr("pinn_cli.paper.runs.run_digest", ",".join)
    patch.setattr("pinn_cli.paper.realisations._settings_digest", "".join)
    patch.setattr("pinn_cli.paper.studies.SEEDS", 3)
    patch.setattr("pinn_cli.paper.studies.KAPPAS", (0.0, 10000.0))
    patch.setattr("pinn_cli.paper.studies.FORCES", (1.0, 10.0))


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    make_quick(monkeypatch)


@pytest.fixture(scope="session")
def paper(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole outputs/paper from made-up runs and scores."""
    output = tmp_path_factory.mktemp("outputs") / "paper"
    with pytest.MonkeyPatch.context() as patch:
        make_quick(patch)
        assert make_seeds(output, FakeSolver()) == 0
        assert make_paper(output, FakeRunner()) == 0
        solver = FakeSolver()
        solver.diverging = {f"none_kappa10000_force10_seed{seed}" for seed in range(2)}
        assert make_nonlinearity(output, solver) == 0  # one that diverges is a finding
    return output
