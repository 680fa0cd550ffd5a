from __future__ import annotations

import numpy as np
import pytest
import torch
from small_problems import accelerations, measured, relative_error, small_chain

from pinn_cli.errors import InputError
from pinn_cli.network.spline import Spline
from pinn_cli.physics import targets
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.function_space.collocation import collocate


def problem(snr_db: float | None = 20.0, seed: int = 0) -> Problem:
    chain = small_chain()
    return Problem(chain, accelerations(measured(chain, snr_db=snr_db, samples=2049, seed=seed).record))


def test_there_are_as_many_points_as_the_record_has_independent_values():
    given = problem()
    assert len(collocate(given, None, 10000, "cpu").target.physics_time) == Spline().build(given.record).count


def test_few_residuals_take_fewer_points():
    fewer = collocate(problem(), None, 400, "cpu").target
    assert len(fewer.physics_time) == 400 // 5  # two sensors, three equations of motion


def test_too_few_points_for_the_band_are_an_input_error():
    with pytest.raises(InputError, match=r"training.collocation_points=12: must be a whole number >= .* Hz"):
        collocate(problem(), 12, 10000, "cpu")


def test_low_passing_takes_as_much_noise_out_as_it_says():
    noisy, clean = problem(), problem(snr_db=None)
    collocation = collocate(noisy, 150, 10000, "cpu")
    samples = torch.linspace(0, 2048, 150).round().long()
    truth = targets(clean.record, clean.chain).at(samples)
    for dof in range(2):
        error = (collocation.target.response["acceleration"] - truth.response["acceleration"])[:, dof]
        assert float(error.square().mean().sqrt()) == pytest.approx(collocation.response["acceleration"][dof], rel=0.35)
    force = (collocation.target.force - truth.force)[:, 0]
    assert float(force.square().mean().sqrt()) == pytest.approx(collocation.force[0], rel=0.35)
    assert np.isnan(collocation.force[1:]).all()


def test_a_clean_record_stays_as_it_is():
    clean = problem(snr_db=None)
    collocation = collocate(clean, 150, 10000, "cpu")
    whole = targets(clean.record, clean.chain).at(torch.linspace(0, 2048, 150).round().long())
    for quantity in ("acceleration",):
        assert relative_error(collocation.target.response[quantity].numpy(), whole.response[quantity].numpy()) < 1e-3
