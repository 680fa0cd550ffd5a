"""Another model of damping is told where the structure has it, and only there."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from lacking_records import C, K, M, moved
from lacking_records import recorded as shaken
from small_problems import accelerations, measured, small_chain

from pinn_cli.network.spline import Spline
from pinn_cli.record.record import Record
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.building import build_chain, damped
from pinn_cli.system.connection import Linear
from pinn_cli.system.structure import Structure
from pinn_cli.training.doubts.damping_score import scored_damping
from pinn_cli.training.doubts.other_damping import DECISIVE_DAMPING, DampingDoubt, with_other_damping
from pinn_cli.training.history import History
from pinn_cli.training.inference import infer
from pinn_cli.training.point import Point
from pinn_cli.training.solver import Solver

RATIO = 0.06


def recorded(structure: Structure, seed: int = 0) -> Record:
    return accelerations(measured(structure, snr_db=40.0, duration=40.0, samples=801, seed=seed).record, (1, 2, 3))


def doubt(records: list[Record], model: Structure, kind: str) -> DampingDoubt:
    found = scored_damping(infer(posed(records, model, kind), Solver((Spline(),) * len(records), History(False))))
    assert found is not None
    return found


def posed(records: list[Record], model: Structure, kind: str) -> JointProblem:
    """With unknown springs and dampers, or ratios."""
    free = [p for p in model.every_parameter() if p.kind in ("k", kind)]
    return JointProblem.of(*(Problem(model, record, tuple(map(wide, free))) for record in records))


def wide(p):
    return replace(p, prior_std=10.0 * max(abs(p.prescribed), 1e-3), unknown=True)


def of_modes() -> Structure:
    return damped(small_chain("linear").with_parameters(c=torch.zeros(3, dtype=torch.float64)), {"ratio": [RATIO] * 3})


@pytest.mark.parametrize("count", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_ratio_for_each_mode_is_told_beside_dampers(count):
    records = [recorded(of_modes(), seed) for seed in range(count)]
    found = doubt(records, small_chain("linear"), "c")
    assert found.of_modes
    assert found.log_odds > DECISIVE_DAMPING
    np.testing.assert_allclose(found.other_ratios, RATIO, rtol=0.2)


@pytest.mark.parametrize("count", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_right_model_of_damping_is_left_alone(count):
    records = [recorded(small_chain("linear"), seed) for seed in range(count)]
    assert doubt(records, small_chain("linear"), "c").log_odds < 0.0


@pytest.mark.slow
def test_both_models_have_one_prior_of_the_motion():
    """In another order of the unknowns the ridge differed: a wrong model was e^40 times as probable as a right one."""
    model = build_chain(3, Linear(), m=M.tolist(), c=C.tolist(), k=K.tolist())
    record = shaken(moved(True, 1, ()), snr_db=20.0)
    found = infer(posed([record], model, "c"), Solver((Spline(),), History(False)))
    assert scored_damping(found).log_odds < 0.0
    ((own, at),) = found.by_record
    extended = with_other_damping(found.problem, {kind: x.numpy() for kind, x in own.parameters(at).items()})
    evidence = found.solver.evidence(extended, [own.network])
    evidence.equations.share_ridges(found.evidence.equations)
    (other,) = evidence.equations.by_record
    again = Point(other.layout.unknowns(own.layout.weights(at.unknowns)), at.parameters)
    noise = found.trained.noise.records[0]
    assert other.ridge.loss(again, noise) == pytest.approx(own.ridge.loss(at, noise), rel=1e-9)
