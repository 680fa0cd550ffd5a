"""What a record hands over to one that goes on before it ends: a window, and the next."""

from dataclasses import replace

import numpy as np
import pytest
from storeys import C, K, M, cut, record

from pinn_cli.network.spline import Spline
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.training.estimator import TrainedNetwork
from pinn_cli.training.gauss_newton import GaussNewton

STRUCTURE = build_chain(3, Linear(), m=M.tolist(), c=(1.04 * C).tolist(), k=(1.1 * K).tolist())
HAND_OVER = 4.5


def solved(problem: JointProblem) -> Estimate:
    return TrainedNetwork(GaussNewton(learn_spread=False), Spline()).solve(problem, RunContext())


def test_later_samples_are_not_in_it():
    """It is what those before the hand-over say by themselves, up to the noise that they tell."""
    problem = SparseRecovery().pose(STRUCTURE, [record(1, duration=6.0).record])
    own = problem.alone
    whole = solved(JointProblem.of(replace(own, hand_over=HAND_OVER)))
    early = cut(own.record, slice(0, 1 + int(np.searchsorted(own.record.time, HAND_OVER - 1e-6))))
    alone = solved(SparseRecovery().pose(STRUCTURE, [early]))
    handed = whole.handed_over
    assert handed.end.time == pytest.approx(HAND_OVER)
    std = np.sqrt(np.diag(alone.known.covariance))
    assert (np.abs(handed.known.mean - alone.known.mean) < 0.3 * std).all()
    np.testing.assert_allclose(np.sqrt(np.diag(handed.known.covariance)), std, rtol=0.1)
    assert (np.diag(handed.known.covariance) > np.diag(whole.known.covariance)).all()
    state = np.sqrt(np.diag(alone.end.covariance))
    assert (np.abs(handed.end.mean - alone.end.mean) < 0.5 * state).all()
    np.testing.assert_allclose(np.sqrt(np.diag(handed.end.covariance)), state, rtol=0.1)
