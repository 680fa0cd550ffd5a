"""Stand-ins for finished runs: their files, made up, in seconds less than a run takes."""

from __future__ import annotations

from functools import cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd
import pytest
from fake_solver import FakeSolver
from matplotlib.figure import Figure

from pinn_cli.paper.commands import make_nonlinearity, make_paper, make_seeds
from pinn_cli.report import published
from pinn_cli.runs.writing import write_json, write_table

if TYPE_CHECKING:
    from pinn_cli.paper.cases import PlannedRun

SECONDS = {"estimate": 2.0, "baseline": 1.0, "total": 4.0}


def _fitness(case: str, estimator: str, offset: float) -> pd.DataFrame:
    table = published.fitness()
    cells = table.loc[table["case"] == case, ["group", "quantity", "fitness_percent"]]
    if cells.empty:  # the Bayesian cases have no published fitness
        cells = pd.DataFrame({"group": ["all"], "quantity": ["displacement"], "fitness_percent": [90.0]})
    ranged = cells["fitness_percent"] + offset
    return cells.assign(estimator=estimator, range_fitness_percent=ranged, fitness_percent=90.0)


def _parameters(case: str, estimator: str, error_percent: float) -> pd.DataFrame:
    table = published.parameters()
    table = table.loc[table["case"] == case, ["parameter", "true"]]
    if case == "sr_6dof_perturbed":
        table = published.perturbed_parameters()[["parameter", "true"]]
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


def _draw(directory: Path) -> None:
    directory.mkdir(exist_ok=True)
    for name in ("response", "error_map", "posterior_pairs"):
        for ending in ("png", "pdf"):
            (directory / f"{name}.{ending}").write_bytes(_picture(name, ending))


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
            _draw(directory / "figures")
        return 5.0


@pytest.fixture
def runner() -> FakeRunner:
    return FakeRunner()


@pytest.fixture(scope="session")
def paper(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole outputs/paper from made-up runs and scores; digests have tests of their own."""
    output = tmp_path_factory.mktemp("outputs") / "paper"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pinn_cli.paper.runs.run_digest", ",".join)
        patch.setattr("pinn_cli.paper.robustness.scored._settings_digest", "".join)
        assert make_paper(output, FakeRunner()) == 0
        assert make_seeds(output, FakeSolver()) == 0
        assert make_nonlinearity(output, FakeSolver()) == 0
    return output


@pytest.fixture
def quick_digests(monkeypatch: pytest.MonkeyPatch) -> None:
    """Papers without true digests, for tests of something else."""
    monkeypatch.setattr("pinn_cli.paper.runs.run_digest", ",".join)
