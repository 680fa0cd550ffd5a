"""Records one after the other: what the first leaves known is the prior of the second."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from storeys import C, K, M, cut, record

from pinn_cli.model.knowledge import Levels, Model
from pinn_cli.network.spline import Spline
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.scheme.update import Update
from pinn_cli.settings.errors import InputError
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.training.changes import UpdatedNetwork
from pinn_cli.training.estimate import Estimate, RunContext, estimated_structure
from pinn_cli.training.estimator import TrainedNetwork
from pinn_cli.training.gauss_newton import GaussNewton
from pinn_cli.training.record_scales import force_and_velocity_scale

PRESCRIBED = build_chain(3, Linear(), m=M.tolist(), c=(1.04 * C).tolist(), k=(1.1 * K).tolist())
SCHEME = StateParameter(unknown=["k_*"], starts="given")


def estimated(problem, network=TrainedNetwork) -> Estimate:
    return network(GaussNewton(), Spline()).solve(problem, RunContext())


def model_of(problem, estimate: Estimate) -> Model:
    """As a report writes it, without the file."""
    noise, seen = estimate.noise, problem.alone.record
    sensors = {quantity: noise.sensors[quantity] for quantity in ("acceleration", "force")}
    force, _ = force_and_velocity_scale(problem.alone)
    features = estimate.summary["features_per_dof"] / seen.duration
    levels = Levels(sensors, noise.discrepancy, seen.step, force, features)
    structure = estimated_structure(PRESCRIBED, estimate.parameters)
    parameters = tuple(p.parameter for p in estimate.parameters)
    return Model(structure, parameters, estimate.known, levels, estimate.end, "sound", "")


@cache
def first(seed: int = 1) -> tuple[Estimate, Model]:
    problem = SCHEME.pose(PRESCRIBED, [record(seed).record])
    found = estimated(problem)
    return found, model_of(problem, found)


def values(estimate: Estimate) -> tuple[np.ndarray, np.ndarray]:
    return tuple(np.array([getattr(p, name) for p in estimate.parameters]) for name in ("estimate", "std"))


@pytest.mark.slow
def test_two_halves_one_after_the_other_are_both_together():
    whole = record(3, duration=24.0).record
    half = len(whole.time) // 2
    halves = [cut(whole, slice(0, half)), cut(whole, slice(half, None))]
    together, both = values(estimated(SCHEME.pose(PRESCRIBED, halves)))
    problem = SCHEME.pose(PRESCRIBED, [halves[0]])
    model = model_of(problem, estimated(problem))
    after, spread = values(estimated(Update(model).pose(PRESCRIBED, [halves[1]]), UpdatedNetwork))
    assert np.abs(after - together).max() > 0.0
    assert np.abs((after - together) / both).max() < 0.3
    np.testing.assert_allclose(spread, both, rtol=0.1)


@pytest.mark.slow
def test_a_spring_that_lost_a_twentieth_is_named_and_left_open():
    _, model = first()
    same = estimated(Update(model).pose(PRESCRIBED, [record(2).record]), UpdatedNetwork)
    assert same.changes.found == ()
    assert same.changes.chance > 1e-3
    less = estimated(Update(model).pose(PRESCRIBED, [record(2, third=0.95).record]), UpdatedNetwork)
    assert [change.parameter.name for change in less.changes.found] == ["k_3"]
    change = less.changes.found[0]
    assert change.by == pytest.approx(-0.05 * K[2], abs=4.0 * change.std)
    assert (change.chance, change.share) == (pytest.approx(0.0, abs=1e-6), pytest.approx(1.0, abs=1e-3))
    found = next(p for p in less.parameters if p.name == "k_3")
    usual = next(p for p in same.parameters if p.name == "k_3")
    assert found.estimate == pytest.approx(0.95 * K[2], abs=4.0 * found.std)
    assert found.prior_std > K[2] > 100.0 * usual.prior_std  # this record alone says what it is now
    assert found.std > usual.std


def test_a_spring_that_lost_a_sixth_is_named_however_well_it_was_known():
    """Held by a prior that is a thousand deviations off, the record would say nothing: all would be left out."""
    problem = SCHEME.pose(PRESCRIBED, [record(1, snr_db=80.0).record])
    model = model_of(problem, estimated(problem))
    less = estimated(Update(model).pose(PRESCRIBED, [record(2, third=0.84, snr_db=80.0).record]), UpdatedNetwork)
    assert [change.parameter.name for change in less.changes.found] == ["k_3"]
    assert less.changes.found[0].by == pytest.approx(-0.16 * K[2], abs=4.0 * less.changes.found[0].std)


def test_a_new_record_without_a_search():
    _, model = first()
    new = record(2)
    problem = SparseRecovery(model=model).pose(PRESCRIBED, [new.record])
    assert [p.unknown for p in problem.alone.uncertain] == [False] * 6
    found = estimated(problem)
    exact = build_chain(3, Linear(), m=M.tolist(), c=C.tolist(), k=K.tolist())
    known = estimated(SparseRecovery(parameter_uncertainty=0.0).pose(exact, [new.record]))
    for quantity in ("displacement", "velocity", "acceleration"):
        true = getattr(new.truth, quantity)
        ours, theirs = (np.linalg.norm(getattr(e.response, quantity) - true) for e in (found, known))
        assert ours < 1.1 * theirs
    assert found.summary["factorisations"] < 0.7 * known.summary["factorisations"]


def test_the_state_at_the_end():
    found, _ = first()
    assert found.end.time == found.response.time[-1]
    last = [np.concatenate((r.displacement[-1], r.velocity[-1])) for r in (found.response, found.std)]
    np.testing.assert_allclose(found.end.mean, last[0], rtol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.diag(found.end.covariance)), last[1], rtol=1e-6)
    assert np.linalg.eigvalsh(found.end.covariance).min() > 0.0
    std = np.array([p.std for p in found.parameters])
    correlation = found.end.with_parameters / np.outer(last[1], std)
    assert np.abs(correlation).max() < 1.0


def test_what_misfit_hides_does_not_average_out_over_records():
    _, model = first()
    told = replace(model.known, told=np.full(6, 1e9), weight=np.full(6, 1e6))
    problem = Update(replace(model, known=told)).pose(PRESCRIBED, [record(2).record])
    found = estimated(problem)
    hidden = found.known.hidden
    assert hidden[3] == pytest.approx(1e3, rel=0.05)
    assert next(p for p in found.parameters if p.name == "k_1").std > 900.0


def test_what_cannot_be_updated_is_refused():
    _, model = first()
    with pytest.raises(InputError, match="the directory of a finished run with scheme=update"):
        Update(None)
    fixed = replace(model, parameters=(), known=model.known.of(np.array([], dtype=int)))
    with pytest.raises(InputError, match="held fixed"):
        Update(fixed)
    unsure = replace(model, known=replace(model.known, covariance=np.full((6, 6), np.nan)))
    with pytest.raises(InputError, match="gives standard deviations"):
        Update(unsure).pose(PRESCRIBED, [record(2).record])
    both = [record(1).record, record(2).record]
    for scheme in (Update(model), SparseRecovery(model=model)):
        with pytest.raises(InputError, match="one record with"):
            scheme.pose(PRESCRIBED, both)


def test_a_gradient_training_is_refused():
    from pinn_cli.network.mlp import Mlp
    from pinn_cli.training.gradient.adam import Adam

    _, model = first()
    problem = Update(model).pose(PRESCRIBED, [record(2).record])
    with pytest.raises(InputError, match="model"):
        TrainedNetwork(Adam(), Mlp()).check(problem.alone)
