"""Stand-ins for finished runs: their files, made up, in seconds less than a run takes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd
import pytest
import xarray as xr
from fake_posteriors import LABELS, UNITS, make_findings, make_record, make_samples
from fake_solver import FakeSolver

from pinn_cli.paper.case_runs import CaseRun
from pinn_cli.record.record import QUANTITIES
from pinn_cli.report import published
from pinn_cli.report.dataset import response_dataset, write_dataset
from pinn_cli.report.posterior_data import posterior_groups, write_posterior_data
from pinn_cli.runs.writing import write_json, write_table

if TYPE_CHECKING:
    from collections.abc import Callable

    from pinn_cli.paper.case_runs import Variant

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


def _write_response(directory: Path, make_case: Callable, ndof: int) -> None:
    case = make_case(ndof=ndof, samples=60)
    dataset = response_dataset(case.estimate, case.record, case.truth.response, case.labels)
    beside = {f"{name}_kalman_smoother": dataset[name] * 1.01 for name in QUANTITIES}
    write_dataset(dataset.assign(beside), directory / "response.nc")


def _write_posterior(directory: Path) -> None:
    samples = make_samples()
    groups: dict[str, xr.Dataset] = posterior_groups(make_findings(samples), make_record(), UNITS, LABELS)
    write_posterior_data(groups, directory / "posterior.nc")


class FakeRunner:
    """Leaves behind what a run leaves; `calls` are those made.

    Ours is better than the published values by `offset` and the smoother half as much; the cases in `failing` raise
    that instead.
    """

    def __init__(self, make_case: Callable) -> None:
        self.make_case = make_case
        self.calls: list[str] = []
        self.failing: dict[str, BaseException] = {}
        self.offset = 0.2

    def __call__(self, case: str, variant: Variant, directory: Path) -> CaseRun:
        if case in self.failing:
            raise self.failing[case]
        self.calls.append(directory.name)
        offsets = {"pinn": self.offset}
        if "baseline=kalman_smoother" in variant.overrides and not case.startswith("pe_"):
            offsets["kalman_smoother"] = self.offset / 2.0
        fitness = pd.concat([_fitness(case, name, offset) for name, offset in offsets.items()])
        parameters = pd.concat([_parameters(case, name, 1.0 - offset) for name, offset in offsets.items()])
        write_table(fitness, directory / "fitness.csv")
        write_table(parameters, directory / "parameters.csv")
        write_json({"seconds": SECONDS}, directory / "run.json")
        if case.startswith("pe_"):
            _write_posterior(directory)
        _write_response(directory, self.make_case, ndof=3)
        return CaseRun(case, variant.name, fitness, 4.0, 5.0, parameters)


@pytest.fixture
def runner(make_case: Callable) -> FakeRunner:
    return FakeRunner(make_case)


@pytest.fixture(scope="session")
def paper(make_case: Callable, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole outputs/paper from made-up runs and studies; digests and the linear chain have tests of their own."""
    from pinn_cli.paper.making import make_nonlinearity, make_paper, make_seeds

    output = tmp_path_factory.mktemp("outputs") / "paper"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pinn_cli.paper.runs.run_digest", ",".join)
        linear = make_case(ndof=3, samples=60).truth.response
        patch.setattr("pinn_cli.paper.figures.equivalent_linear", lambda _: linear)
        patch.setattr("pinn_cli.paper.study.results._settings_digest", "".join)
        assert make_paper(output, FakeRunner(make_case)) == 0
        assert make_seeds(output, FakeSolver()) == 0
        assert make_nonlinearity(output, FakeSolver()) == 0
    return output


@pytest.fixture
def nothing_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Papers without figures or true digests, for tests of something else."""
    monkeypatch.setattr("pinn_cli.paper.runs.run_digest", ",".join)
    monkeypatch.setattr("pinn_cli.paper.figures.draw_figures", lambda *_: set())
