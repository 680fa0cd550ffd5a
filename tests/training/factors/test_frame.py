"""Residuals in windows of time: a record that takes many is solved as one that takes a single one."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from one_record import factored, residuals_of, shared
from small_problems import measured, small_chain
from structures import braced, hysteretic

from pinn_cli.network.spline import Spline
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.functions import Inputs
from pinn_cli.system.structure import Structure
from pinn_cli.training.covariance import ReadoutPosterior
from pinn_cli.training.estimator import built
from pinn_cli.training.factors import frame
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.point import Point
from pinn_cli.training.reported.connection_forces import connection_forces, dissipated_energy
from pinn_cli.training.starting_noise import starting_noise


def posed(structure: Structure, samples: int = 49) -> tuple[NormalEquations, NoiseModel]:
    record = measured(
        small_chain(ndof=structure.ndof), snr_db=40.0, duration=6.0, samples=samples
    ).record  # any will do
    uncertain = tuple(replace(p, prior_std=0.05 * abs(p.prescribed)) for p in structure.every_parameter())
    inputs = Inputs(rate=4.0) if len(structure.memory) else Inputs()
    problem = Problem(structure, record, uncertain, inputs=inputs)
    equations = NormalEquations(built(Spline(intervals=12), problem), problem)
    return equations, starting_noise(equations)


def everything(equations: NormalEquations, noise: NoiseModel) -> dict[str, np.ndarray]:
    """All that is summed or written window by window."""
    start, rng = equations.start(), np.random.default_rng(2)
    away = Point(*(torch.as_tensor(rng.normal(0.0, 0.1, x.shape)) for x in (start.unknowns, start.parameters)))
    point = start.moved((away.unknowns, away.parameters))
    system = equations.assemble(point, noise, np.eye(len(equations.uncertain)))
    factor, whole = factored(system), shared(system)
    posterior, segments = ReadoutPosterior(equations, point, factor), equations.observation
    stretch = equations.dynamics.branches.matrix[: equations.dynamics.structure.incidence.shape[0]]
    moved = [
        torch.cat(each) for each in zip(*(f for _, f in equations.motion.moved(point, [away, start])), strict=True)
    ]
    found = {
        "losses": list(equations.losses(point, noise).values()),
        "log determinant": factor.readout.log_determinant + factor.parameter_log_determinant,
        "step": np.concatenate(whole.factor().step(whole)),
        "moved": torch.stack(moved),
        "motion": torch.stack(equations.flat_states(segments, point)[:3]),
        "functions": torch.stack(posterior.functions(segments)),
        "combined": posterior.combined(segments, [(0, stretch), (1, stretch)]),
        "forces": np.stack(connection_forces(posterior)),
        "energy": np.stack(dissipated_energy(posterior)),
    }
    return {name: np.asarray(value) for name, value in found.items()} | {
        name: each.numpy() for name, each in residuals_of(equations, point).items()
    }


@pytest.mark.parametrize("structure", [small_chain("duffing", 3), braced(), hysteretic()], ids=["chain", "braced", "z"])
def test_windows_change_nothing(structure: Structure, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = everything(*posed(structure))
    monkeypatch.setattr(frame, "ROWS_AT_ONCE", 600)
    monkeypatch.setattr(frame, "KEPT_NUMBERS", 0)
    equations, noise = posed(structure)
    assert len(equations.windows(equations.physics)) > 3
    pieces = everything(equations, noise)
    for name, values in whole.items():
        np.testing.assert_allclose(pieces[name], values, rtol=1e-7, atol=1e-9 * np.abs(values).max(), err_msg=name)


def test_no_more_than_a_window_of_a_long_motion_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frame, "ROWS_AT_ONCE", 600)
    monkeypatch.setattr(frame, "KEPT_NUMBERS", 0)
    equations, noise = posed(small_chain("duffing", 3))
    equations.assemble(equations.start(), noise)
    (states,) = equations._kept_states.values()
    assert len(states.displacement) < equations.averages.count / 2
