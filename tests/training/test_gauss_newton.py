"""Sparse recovery from end to end by Gauss-Newton, on three DOFs, and its steps as docs/method.md tells them."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from calls import Compose
from small_problems import QUANTITIES, measured, small_chain

from pinn_cli.cli.config import RunConfig
from pinn_cli.network.fourier import Fourier
from pinn_cli.network.mlp import Mlp
from pinn_cli.network.spline import Spline
from pinn_cli.record.record import Measurements
from pinn_cli.report.fitness import fitness_percent
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.settings.errors import InputError
from pinn_cli.system.structure import Structure
from pinn_cli.training import inference
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.training.gauss_newton import GaussNewton
from pinn_cli.training.history import History
from pinn_cli.training.solver import Inference, Solver

WITHIN_95 = 1.959964


@cache
def example(hold: str = "exact") -> Measurements:
    return measured(small_chain(), hold, snr_db=40.0, duration=20.0, samples=1024)


def recovered(prescribed: Structure | None = None, record=None, design=None, **settings) -> Estimate:
    scheme = SparseRecovery(unobserved=[3])
    problem = scheme.pose(prescribed or small_chain(), [scheme.observe(record or example().record)])
    return GaussNewton(**settings).solve(problem, design or Spline(), RunContext())


@cache
def found() -> Estimate:
    return recovered()


def off_by(relative: float, seed: int) -> Structure:
    """The chain with every c, k and kappa off by as much, up or down."""
    structure, rng = small_chain(), np.random.default_rng(seed)
    factors = {kind: torch.as_tensor(1 + relative * rng.choice([-1, 1], 3)) for kind in ("c", "k", "kappa")}
    return structure.with_parameters(**{kind: structure.parameters[kind] * factor for kind, factor in factors.items()})


def covered(estimate: Estimate, truth, quantity: str) -> np.ndarray:
    error = getattr(estimate.response, quantity) - getattr(truth, quantity)
    return (np.abs(error) < WITHIN_95 * getattr(estimate.std, quantity)).mean(axis=0)


@pytest.mark.parametrize(("hold", "design"), [("exact", Fourier()), ("zero_order", Spline())])
def test_an_unobserved_dof_is_recovered(hold, design):
    estimate, truth = recovered(record=example(hold).record, design=design), example(hold).truth.response
    for quantity in QUANTITIES:
        fitness = fitness_percent(getattr(estimate.response, quantity), getattr(truth, quantity))
        assert fitness[2] > 95.0, quantity


def test_the_95_percent_band_covers_the_truth():
    estimate = found()
    truth = example().truth.response
    for quantity in QUANTITIES:
        assert 0.85 <= covered(estimate, truth, quantity).mean() <= 1.0, quantity
        assert fitness_percent(getattr(estimate.response, quantity), getattr(truth, quantity))[2] > 95.0, quantity
    assert estimate.summary["stop_reason"] == "converged"
    assert estimate.summary["parameter_spread"] < 0.5  # right parameters sharpen each other
    assert estimate.std.displacement.mean() < 0.05 * example().truth.response.displacement.std()


def test_wrong_parameters_free_each_other():
    estimate = recovered(off_by(0.07, seed=0))
    assert 0.5 < estimate.summary["parameter_spread"] < 2.0
    for p in estimate.parameters:
        if p.name.startswith("k_"):
            assert p.estimate == pytest.approx(15.0, rel=0.02)


def test_history_has_a_row_per_step():
    estimate = found()
    table = estimate.history
    assert list(table["iteration"]) == list(range(1, estimate.summary["iterations"] + 1))
    assert table["seconds"].is_monotonic_increasing
    assert {
        "loss_acceleration",
        "loss_physics",
        "loss_prior",
        "weight_acceleration",
        "weight_forced",
        "weight_unforced",
    } <= set(table)
    assert table.notna().all(axis=None)


def test_fixed_weights():
    weights = {"observation": 1.0, "continuity": 10.0, "physics": 100.0}
    estimate = recovered(weights=weights, iterations=40)
    truth = example().truth.response
    largest = np.abs(example().record.acceleration).max(axis=0)
    np.testing.assert_allclose(estimate.noise.sensors["acceleration"][:2], largest[:2])
    assert fitness_percent(estimate.response.acceleration, truth.acceleration)[0] > 80.0


def test_fixed_weights_of_a_network_without_linear_readout_are_an_input_error():
    weights = {"observation": 1.0, "continuity": 10.0, "physics": 100.0}
    with pytest.raises(InputError, match=r"training.weights=.*network=mlp has no linear readout"):
        recovered(design=Mlp(2, 8, "sine"), weights=weights)


@pytest.mark.slow
def test_coverage_over_noise_seeds_of_the_default_problem(composed: Compose):
    shares = []
    for seed in range(10):
        config = RunConfig.read(composed("noise.snr_db=20", f"seed={seed}"), base=Path.cwd())
        true, prescribed = config.model_error.structures(config.structure)
        measurements = config.source.measure(true)
        problem = config.scheme.pose(prescribed, [config.observe(measurements.record)])
        estimate = config.training.solve(problem, config.network, RunContext(seed=seed))
        shares.append([covered(estimate, measurements.truth.response, quantity).mean() for quantity in QUANTITIES[:2]])
    displacement, velocity = np.mean(shares, axis=0)
    assert 0.88 <= displacement <= 0.99
    assert 0.88 <= velocity <= 0.99


METHOD = Path(__file__).parents[2] / "docs" / "method.md"


def test_the_docs_tell_the_steps_that_there_are():
    told = re.findall(r"^\| `(\w+)` \| (\d+) \|", METHOD.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert told == [(step.__name__, str(rounds)) for step, rounds in inference.STEPS]


def test_a_step_is_asked_until_it_has_nothing_better_and_so_many_times_at_most(monkeypatch):
    asked: list[str] = []

    def better(found: Inference) -> Inference:
        asked.append("better")
        return replace(found, narrowed=found.narrowed + 1.0)

    def nothing(found: Inference) -> None:
        asked.append("nothing")

    monkeypatch.setattr(inference, "STEPS", ((nothing, 5), (better, 3)))
    structure = small_chain("linear")
    problem = JointProblem.of(Problem(structure, measured(structure, duration=4.0, samples=101).record))
    found = inference.infer(problem, Solver((Spline(),), History(False)))
    assert asked == ["nothing"] + 3 * ["better"]
    assert found.narrowed == 4.0
