"""What is handed over to a next window, and the force that a model leaves out."""

from dataclasses import replace

import numpy as np
import pytest
from one_record import by_spline
from storeys import C, K, M, cut, record

from pinn_cli.network.spline import Spline
from pinn_cli.record.free_run import free_run
from pinn_cli.record.record import Record
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.training.estimate import Estimate, RunContext, estimated_structure
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


# A mass that is wrong by a tenth, where the load cell is.
HEAVIER = M * np.array([1.0, 1.0, 1.1])


def estimated(seen: Record, m: np.ndarray = M) -> Estimate:
    structure = build_chain(3, Linear(), m=m.tolist(), c=C.tolist(), k=K.tolist())
    scheme = StateParameter(unknown=["k_*"], starts="given")
    found = by_spline(scheme.pose(structure, [seen]))
    assert found.misfit is not None
    return replace(found, summary=found.summary | {"structure": estimated_structure(structure, found.parameters)})


def off(found: Estimate, seen: Record, force: np.ndarray) -> np.ndarray:
    """Distance of the free run's displacements under a force from the estimate's, over these."""
    start = found.response.displacement[0], found.response.velocity[0]
    acting = replace(seen, force=force, unforced=np.zeros(seen.ndof, dtype=bool))
    run = free_run(found.summary["structure"], acting, start).displacement
    estimate = found.response.displacement
    return np.linalg.norm(run - estimate, axis=0) / np.linalg.norm(estimate, axis=0)


def test_with_the_right_model_nothing_is_left_out_but_the_noise_of_the_load_cell():
    each = record(1, duration=6.0)
    found, sigma = estimated(each.record), float(each.noise["force"][2])
    left = found.misfit.history.std(axis=0)
    assert left.max() < 0.2 * sigma
    assert found.misfit.rest < 0.2 * sigma
    assert found.misfit.acting == pytest.approx(np.sqrt(np.mean(each.record.force**2)))


@pytest.mark.slow
def test_a_wrong_mass_below_the_load_cell_is_left_out_whatever_the_cell_is_taken_for():
    seen = record(1, duration=6.0, snr_db=40.0).record
    found = estimated(seen, HEAVIER)
    left = found.misfit.history
    assert left[:, 2].std() > 3.0 * record(1, duration=6.0, snr_db=40.0).noise["force"][2]
    under_force, under_both = off(found, seen, seen.force), off(found, seen, seen.force + left)
    assert (under_both < 0.35 * under_force).all()
    assert found.misfit.at_motion > 0.7
