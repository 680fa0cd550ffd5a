"""Standard deviations of DOFs that feel every mode, taken for all of them at once, against one at a time."""

from dataclasses import replace

import numpy as np
import torch
from one_record import factored
from structures import modal

from pinn_cli.network.spline import Spline
from pinn_cli.record.record import Record
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.functions import Inputs
from pinn_cli.training.covariance import ReadoutPosterior
from pinn_cli.training.estimator import built
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.starting_noise import starting_noise

SAMPLES, NONE = 33, float("nan")


def test_all_channels_at_once_are_as_one_by_one():
    structure, random = modal(), np.random.default_rng(5)
    motion = random.standard_normal((SAMPLES, 4)) * [1.0, NONE, 1.0, NONE]
    force = random.standard_normal((SAMPLES, 4)) * [1.0, NONE, 0.0, 1.0]
    record = Record(
        np.linspace(0.0, 3.0, SAMPLES), np.full((SAMPLES, 4), NONE), np.full((SAMPLES, 4), NONE), motion, force,
        np.array([False, False, True, False]), ground_acceleration=random.standard_normal(SAMPLES),
    )  # fmt: skip
    uncertain = tuple(
        replace(p, prior_std=0.05 * abs(p.prescribed)) for p in structure.every_parameter() if p.prescribed
    )
    problem = Problem(structure, record, uncertain, inputs=Inputs(True, True, True, (1,), 0.3, 4.0, 5.0, (0, 3)))
    equations = NormalEquations(built(Spline(intervals=8), problem), problem)
    point = equations.start()
    factor = factored(equations.assemble(point, starting_noise(equations), np.eye(len(equations.uncertain))))
    posterior = ReadoutPosterior(equations, point, factor)
    found = posterior.sensed(equations.observation)
    for quantity in ("displacement", "velocity", "acceleration"):
        expected = posterior.combined(equations.observation, equations.dynamics.sensing(quantity))
        assert found[quantity].shape == (SAMPLES, 4)
        torch.testing.assert_close(found[quantity], expected, rtol=1e-9, atol=1e-12)


def test_a_parameter_of_modes_is_as_strong_as_it_pulls_at_them():
    """In the unit of the modes' equations: what it does to its connection, times the length of the shapes there."""
    structure, silent = modal(), np.full((SAMPLES, 4), NONE)
    motion, force = silent.copy(), np.zeros((SAMPLES, 4))
    motion[:, 0] = np.random.default_rng(6).standard_normal(SAMPLES)
    record = Record(np.linspace(0.0, 3.0, SAMPLES), silent, silent, motion, force, np.ones(4, dtype=bool))
    spring = next(p for p in structure.every_parameter() if p.kind == "k" and p.index == 3)
    problem = Problem(structure, record, (replace(spring, prior_std=1.0),))
    equations = NormalEquations(Spline(intervals=8).build(record, functions=problem.dynamics.size), problem)
    start = equations.start()
    moved = replace(start, unknowns=torch.linspace(-1.0, 1.0, len(start.unknowns), dtype=torch.float64))
    strength = equations.motion.own_by_parameter(equations.physics, moved)[..., spring.index]
    rows = equations.motion.rows(equations.physics, moved).parameter
    pulled = rows[..., 0, :].square().sum((-1, -2)).sqrt()
    torch.testing.assert_close(strength.abs(), pulled, rtol=1e-9, atol=1e-12)
