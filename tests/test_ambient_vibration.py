"""Frames under forces that nobody measured: motion, forces and bands, on records that scipy made."""

from __future__ import annotations

import numpy as np
import pytest
from ambient_records import ambient_record

from pinn_cli.network.spline import Spline
from pinn_cli.report.fitness import fitness_percent
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.training.base import TrainedNetwork
from pinn_cli.training.estimate import RunContext
from pinn_cli.training.gauss_newton import GaussNewton
from pinn_cli.verdict.judge import judge


def solved(made, uncertainty=0.0):
    problem = SparseRecovery(parameter_uncertainty=uncertainty).problem(made.structure, made.record)
    return problem, TrainedNetwork(GaussNewton(), Spline()).solve(problem, RunContext())


def inside(estimate, std, truth):
    return float(np.mean(np.abs(estimate - truth) < 1.96 * std))


@pytest.mark.parametrize(
    ("first_frequency", "rate", "duration", "edge"),
    [(4.0, 100.0, 5.0, 25.0), (4.0, 50.0, 5.0, None), (1.0, 50.0, 14.0, None)],
    ids=["forces far below the Nyquist frequency", "forces up to it", "forces far above the structure"],
)
def test_motion_and_forces_with_their_bands(first_frequency, rate, duration, edge):
    made = ambient_record(first_frequency, rate, duration, edge, seed=2)
    problem, estimate = solved(made)
    found, std, truth = estimate.response, estimate.std, made.truth
    assert np.all(fitness_percent(found.displacement, truth.displacement)[[0, 2]] > 80.0)  # slow drift included
    for quantity in ("displacement", "velocity", "acceleration", "force"):
        held = inside(*(getattr(x, quantity) for x in (found, std, truth)))
        assert 0.88 < held < 0.997, (quantity, held)
    # Flat forces come out as large as they are, and are not taken for the sensors' noise.
    assert estimate.summary["std_unknown_force"] == pytest.approx(truth.force.std(), rel=0.2)
    sigma = np.array([s for s in estimate.summary["sigma_acceleration"] if s is not None])
    assert np.all((sigma > 0.5 * made.noise) & (sigma < 4.0 * made.noise))
    assert judge(problem, estimate).word == "sound"


def test_the_colour_of_forces_is_found():
    made = ambient_record(3.0, 100.0, 10.0, 40.0, corner=1.5, seed=1)
    _, estimate = solved(made)
    assert estimate.summary["correlation_time_unknown_force"] == pytest.approx(1.0 / (2.0 * np.pi * 1.5), rel=0.7)
    held = inside(estimate.response.displacement, estimate.std.displacement, made.truth.displacement)
    assert 0.85 < held < 0.995


def test_parameters_that_no_force_tells_are_questionable_and_stay_near_what_was_believed():
    problem, estimate = solved(ambient_record(4.0, 100.0, 3.0, 25.0, floors=2, sensors=(0, 1)), uncertainty=0.05)
    off = [abs(p.estimate / p.prescribed - 1.0) for p in estimate.parameters]
    assert max(off) < 0.4
    assert estimate.summary["parameter_spread"] == 1.0
    verdict = judge(problem, estimate)
    assert verdict.word == "questionable"
    assert any(reason.kind == "output_only_parameters" for reason in verdict.reasons)
