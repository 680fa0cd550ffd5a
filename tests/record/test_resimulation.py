"""What a chain does under the force of a record, between whose samples the record says what happens."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from beams import beam, deflection, response
from small_problems import measured, small_chain

from pinn_cli.record.ensemble import Members, spread_of
from pinn_cli.record.record import Record
from pinn_cli.record.resimulation import TooStiffError, resimulate
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.record.simulation import OverflowsError
from pinn_cli.record.steps import with_slow_followers
from pinn_cli.system.finite_elements import build_finite_elements

REST = np.zeros(3)


def assert_same(found, expected, tolerance: float) -> None:
    for quantity in RESPONSE_QUANTITIES:
        values = getattr(expected, quantity)
        np.testing.assert_allclose(getattr(found, quantity), values, atol=tolerance * np.abs(values).max())


@pytest.mark.parametrize(("hold", "tolerance"), [("exact", 2e-4), ("zero_order", 1e-12)])
@pytest.mark.parametrize("nonlinearity", ["linear", "duffing", "van_der_pol"])
def test_the_true_chain_does_what_the_simulator_said(nonlinearity, hold, tolerance):
    """Of a held force the samples are all there is; one that is not held is a spline through them."""
    structure = small_chain(nonlinearity)
    record, truth = (lambda m: (m.record, m.truth.response))(measured(structure, hold, samples=513))
    assert_same(resimulate(structure, record, (REST, REST)), truth, tolerance)


@pytest.mark.parametrize(("hold", "tolerance"), [("exact", 1e-3), ("zero_order", 1e-10)])
def test_from_the_middle_on(hold, tolerance):
    structure = small_chain()
    measurements = measured(structure, hold, samples=513)
    truth, first = measurements.truth.response, 200
    found = resimulate(structure, measurements.record, (truth.displacement[first], truth.velocity[first]), first=first)
    np.testing.assert_array_equal(found.time, truth.time[first:])
    for quantity in RESPONSE_QUANTITIES:
        values = getattr(truth, quantity)[first:]
        np.testing.assert_allclose(getattr(found, quantity), values, atol=tolerance * np.abs(values).max())


@pytest.mark.parametrize("hold", ["exact", "zero_order"])
def test_under_another_force(hold):
    structure = small_chain("linear")
    record = measured(structure, hold, snr_db=20.0).record
    twice = resimulate(structure, record, (REST, REST), 2.0 * record.force)
    once = resimulate(structure, record, (REST, REST))
    np.testing.assert_allclose(twice.displacement, 2.0 * once.displacement, atol=1e-12)
    np.testing.assert_allclose(once.force, record.force, atol=1e-12)


def test_a_chain_that_the_sampling_is_much_too_slow_for_is_refused():
    record = measured(small_chain(), samples=129).record
    with pytest.raises(TooStiffError, match=r"more than \d+ evaluations per sample"):
        resimulate(small_chain(k=1e9), record, (REST, REST))


def test_all_modes_of_a_beam_do_what_the_whole_model_does(tmp_path):
    """The highest one would take 600 steps per sample; far beyond the band it gets mass, and follows as it did."""
    M, K = beam(10)
    np.savez(tmp_path / "beam.npz", M=M.toarray(), K=K.toarray())
    structure = build_finite_elements(
        {"tip": deflection(10)}, "beam.npz", modes=20, damping_ratio=0.02, ground="1::2", base=tmp_path
    )
    rate, finer = 128.0, 64
    time = np.arange(8 * 128 * finer) / (finer * rate)
    force = np.sin(2.0 * np.pi * np.outer(time, [3.0, 17.0, 40.0])).sum(1) * np.sin(np.pi * time / 8.0) ** 2
    expected = [x[::finer, deflection(10) - 1] for x in response(M, K, 0.02, (deflection(10), force), 1 / finer / rate)]
    samples, blank = time[::finer], np.full((1024, 1), np.nan)
    record = Record(samples, np.zeros((1024, 1)), blank, blank, force[::finer, None], np.array([False]))
    found = resimulate(structure, record, (np.zeros(20), np.zeros(20)))
    for quantity, values in zip(RESPONSE_QUANTITIES, expected, strict=True):
        error = getattr(found, quantity)[:, 0] - values
        assert np.sqrt(np.mean(error**2)) < 3e-3 * np.sqrt(np.mean(values**2))
    members = Members(
        {kind: values[None] for kind, values in structure.parameters_like(np.empty(0)).items()},
        np.zeros((1, 40)), np.zeros((0, 20)), 0,
    )  # fmt: skip
    assert np.nanmax(spread_of(members, structure, record, found).displacement) < 1e-9
    slow, pushed = with_slow_followers(structure, record.step), structure.parameters["m"].numpy()
    assert (slow.parameters["m"].numpy() > 1.0).any()
    np.testing.assert_allclose(slow.parameters["m"].numpy() * slow.with_ground, pushed * structure.with_ground)


def test_a_motion_that_does_not_stay_finite_is_told():
    structure = small_chain("van_der_pol")
    unstable = structure.with_parameters(mu=-50.0 * structure.parameters["mu"])
    record = measured(structure, samples=129).record
    with pytest.raises(OverflowsError):
        resimulate(unstable, record, (REST + 5.0, REST))


def test_a_mass_that_was_estimated_at_its_bound_is_said():
    structure = small_chain()
    record = measured(structure).record
    massless = structure.with_parameters(m=structure.parameters["m"] * torch.tensor([1.0, 0.0, 1.0]))
    with pytest.raises(TooStiffError, match="a mass of it is zero"):
        resimulate(massless, record, (REST, REST))
