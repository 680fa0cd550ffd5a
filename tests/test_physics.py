"""Residuals of the true motion, and the tangent of the connections."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from small_problems import NONLINEARITIES, QUANTITIES, excitation, measured, relative_error, small_chain

from pinn_cli.network.network import States
from pinn_cli.physics import (
    estimated_response,
    hold_delay,
    observation_masks,
    observation_residuals,
    physics_residual,
    targets,
)
from pinn_cli.record.simulation import simulate
from pinn_cli.system.dynamics import Dynamics

ACCELERATIONS = {"derivative": {"acceleration"}, "observer": {"observer"}, "both": {"acceleration", "observer"}}


def states_of(response) -> States:
    return States(*(torch.as_tensor(getattr(response, name)) for name in QUANTITIES), continuity=None)


def smooth_motion(structure, record):
    """The response to the force half a step late, as a function of time: what a held force amounts to."""
    late = hold_delay(record)
    source = excitation(structure, record.duration, len(record.time))

    def force(time):
        return source.force(time - late)

    fine = np.arange(2 * len(record.time)) * (record.step / 2.0)
    response = simulate(structure, force, fine, substeps=4)
    return tuple(
        States(*(torch.as_tensor(getattr(response, name)[start::2]) for name in QUANTITIES), continuity=None)
        for start in (0, 1)
    )


@pytest.mark.parametrize("through", ACCELERATIONS)
@pytest.mark.parametrize("nonlinearity", NONLINEARITIES)
def test_the_true_motion_of_a_band_limited_record_leaves_no_residual(nonlinearity, through):
    structure = small_chain(nonlinearity)
    measurements = measured(structure)
    target, states = targets(measurements.record, Dynamics(structure)), states_of(measurements.truth.response)
    assert torch.equal(target.observation_time, target.physics_time)
    residuals = observation_residuals(states, target, Dynamics(structure), structure.parameters, through)
    assert set(residuals) == {"displacement", "velocity"} | ACCELERATIONS[through]
    for residual in (*residuals.values(), physics_residual(states, target, Dynamics(structure), structure.parameters)):
        torch.testing.assert_close(residual, torch.zeros_like(residual), rtol=0.0, atol=1e-12)


def test_the_true_motion_of_a_held_force_leaves_residuals_of_second_order():
    structure = small_chain()
    errors = {}
    for samples in (257, 513):
        record = measured(structure, "zero_order", samples=samples).record
        target = targets(record, Dynamics(structure))
        at_samples, at_half_steps = smooth_motion(structure, record)
        physics = physics_residual(at_half_steps, target, Dynamics(structure), structure.parameters)
        assert physics.abs().max() < 1e-3 * record.step**2
        for name, residual in observation_residuals(
            at_samples, target, Dynamics(structure), structure.parameters, "both"
        ).items():
            errors.setdefault(name, []).append(residual.square().mean().sqrt().item())
    assert set(errors) == {*QUANTITIES, "observer"}
    for name, (coarse, fine) in errors.items():
        assert np.log2(coarse / fine) == pytest.approx(2.0, abs=0.15), name


def test_the_estimated_response_undoes_what_the_targets_do_to_a_held_force():
    structure = small_chain()
    errors = []
    for samples in (257, 513):
        measurements = measured(structure, "zero_order", samples=samples)
        motion = smooth_motion(structure, measurements.record)
        response = estimated_response(measurements.record, Dynamics(structure), structure.parameters, *motion)
        truth = measurements.truth.response
        np.testing.assert_allclose(response.force, truth.force, atol=1e-3 * measurements.record.step**2)
        errors.append(relative_error(response.acceleration, truth.acceleration))
    # Left alone, the smooth acceleration would be wrong at first order: by half the jump of the force over the mass.
    assert errors[1] < 1e-3
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.15)


def test_the_estimated_response_of_a_band_limited_record_is_the_motion():
    structure = small_chain()
    measurements = measured(structure)
    states = states_of(measurements.truth.response)
    response = estimated_response(measurements.record, Dynamics(structure), structure.parameters, states, states)
    for name in (*QUANTITIES, "force"):
        np.testing.assert_allclose(getattr(response, name), getattr(measurements.truth.response, name), atol=1e-12)
    assert response.time is measurements.record.time


def test_no_equation_and_no_observer_where_the_force_is_unknown():
    structure = small_chain()
    record = measured(structure).record
    force = record.force.copy()
    force[:, 0] = np.nan
    record = replace(record, force=force)
    target = targets(record, Dynamics(structure))
    assert target.equation.tolist() == [False, True, True]
    assert observation_masks(target, "observer")["observer"].tolist() == [False, True, True]
    assert observation_masks(target, "observer")["acceleration"].tolist() == [True, False, False]
    states = states_of(record)
    residual = physics_residual(
        States(*(torch.ones_like(x) for x in states[:3]), None), target, Dynamics(structure), structure.parameters
    )
    assert not residual[:, 0].any()
    assert residual[:, 1:].any()
