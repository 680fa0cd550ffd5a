import numpy as np
import pytest
import torch
from small_problems import accelerations, measured, relative_error, small_chain

from pinn_cli.network.spline import Spline
from pinn_cli.physics import targets
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import InputError
from pinn_cli.system.dynamics import Dynamics
from pinn_cli.training.function_space.collocation import Collocation, collocate


def problem(snr_db: float | None = 20.0, seed: int = 0) -> Problem:
    structure = small_chain()
    return Problem(structure, accelerations(measured(structure, snr_db=snr_db, samples=2049, seed=seed).record))


def collocated(given: Problem, points: int | None, most_rows: int) -> Collocation:
    return collocate(given, targets(given.record, Dynamics(given.structure)), points, most_rows)


def test_there_are_as_many_points_as_the_record_has_independent_values():
    given = problem()
    assert len(collocated(given, None, 10000).target.physics_time) == Spline().build(given.record).count


def test_few_residuals_take_fewer_points():
    fewer = collocated(problem(), None, 400).target
    assert len(fewer.physics_time) == 400 // 5  # two sensors, three equations of motion


def test_too_few_points_for_the_band_are_an_input_error():
    with pytest.raises(InputError, match=r"training.collocation_points=12: must be a whole number >= .* Hz"):
        collocated(problem(), 12, 10000)


def test_low_passing_takes_as_much_noise_out_as_it_says():
    noisy, clean = problem(), problem(snr_db=None)
    collocation = collocated(noisy, 150, 10000)
    samples = torch.linspace(0, 2048, 150).round().long()
    truth = targets(clean.record, Dynamics(clean.structure)).at(samples)
    for dof in range(2):
        error = (collocation.target.response["acceleration"] - truth.response["acceleration"])[:, dof]
        assert float(error.square().mean().sqrt()) == pytest.approx(collocation.response["acceleration"][dof], rel=0.35)
    force = (collocation.target.force - truth.force)[:, 0]
    assert float(force.square().mean().sqrt()) == pytest.approx(collocation.force[0], rel=0.35)
    assert np.isnan(collocation.force[1:]).all()


def test_a_clean_record_stays_as_it_is():
    clean = problem(snr_db=None)
    collocation = collocated(clean, 150, 10000)
    whole = targets(clean.record, Dynamics(clean.structure)).at(torch.linspace(0, 2048, 150).round().long())
    for quantity in ("acceleration",):
        assert relative_error(collocation.target.response[quantity].numpy(), whole.response[quantity].numpy()) < 1e-3
