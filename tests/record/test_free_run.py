"""What a chain does under the force of a record, between whose samples the record says what happens."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from beams import beam, deflection, response
from small_problems import excitation, measured, small_chain

from pinn_cli.record.ensemble import Members, spread_of
from pinn_cli.record.free_run import NoFreeRunError, affordable, free_run
from pinn_cli.record.record import Record
from pinn_cli.record.response import QUANTITIES, RESPONSE_QUANTITIES
from pinn_cli.record.simulation import simulate
from pinn_cli.record.steps import with_slow_followers
from pinn_cli.system.finite_elements import build_finite_elements

REST = np.zeros(3)


def assert_same(found, expected, tolerance: float) -> None:
    for quantity in RESPONSE_QUANTITIES:
        values = getattr(expected, quantity)
        np.testing.assert_allclose(getattr(found, quantity), values, atol=tolerance * np.abs(values).max())


def truth_of(structure, measurements, hold):
    """By a method of order eight where the run is exact: a linear structure; else what the simulator said."""
    if structure.nonlinearity_name != "linear":
        return measurements.truth.response
    return simulate(structure, excitation(structure, 12.0, 513).force, measurements.record.time, hold, "dop853")


@pytest.mark.parametrize(("hold", "tolerance"), [("exact", 1e-6), ("zero_order", 1e-11)])
@pytest.mark.parametrize("nonlinearity", ["linear", "duffing", "van_der_pol"])
def test_the_true_chain_does_what_the_simulator_said(nonlinearity, hold, tolerance):
    """Of a held force the samples are all there is; one that is not held is interpolated."""
    structure = small_chain(nonlinearity)
    measurements = measured(structure, hold, samples=513)
    assert_same(free_run(structure, measurements.record), truth_of(structure, measurements, hold), tolerance)


@pytest.mark.parametrize(("hold", "tolerance"), [("exact", 1e-3), ("zero_order", 1e-10)])
def test_from_the_middle_on(hold, tolerance):
    structure = small_chain()
    measurements = measured(structure, hold, samples=513)
    truth, first = measurements.truth.response, 200
    found = free_run(structure, measurements.record, (truth.displacement[first], truth.velocity[first]), first=first)
    np.testing.assert_array_equal(found.time, truth.time[first:])
    for quantity in RESPONSE_QUANTITIES:
        values = getattr(truth, quantity)[first:]
        np.testing.assert_allclose(getattr(found, quantity), values, atol=tolerance * np.abs(values).max())


def test_a_chain_that_the_sampling_is_much_too_slow_for_is_refused():
    record = measured(small_chain(), samples=129).record
    with pytest.raises(NoFreeRunError, match=r"more than \d+ evaluations per sample"):
        free_run(small_chain(k=1e9), record)


def test_all_modes_of_a_beam_do_what_the_whole_model_does(tmp_path):
    """The highest one would take 600 steps per sample; far beyond the band it gets mass, and follows as it did."""
    M, K = beam(10)
    np.savez(tmp_path / "beam.npz", M=M.toarray(), K=K.toarray())
    structure = build_finite_elements(
        {"tip": deflection(10)}, "beam.npz", modes=20, damping_ratio=0.02, ground="1::2", base=tmp_path
    )
    rate, finer = 128.0, 24
    time = np.arange(2 * 128 * finer) / (finer * rate)
    force = np.sin(2.0 * np.pi * np.outer(time, [3.0, 17.0, 40.0])).sum(1) * np.sin(np.pi * time / 2.0) ** 2
    expected = [x[::finer, deflection(10) - 1] for x in response(M, K, 0.02, (deflection(10), force), 1 / finer / rate)]
    samples, blank = time[::finer], np.full((256, 1), np.nan)
    record = Record(samples, np.zeros((256, 1)), blank, blank, force[::finer, None], np.array([False]))
    found = free_run(structure, record, (np.zeros(20), np.zeros(20)))
    for quantity, values in zip(RESPONSE_QUANTITIES, expected, strict=True):
        error = getattr(found, quantity)[:, 0] - values
        assert np.sqrt(np.mean(error**2)) < 3e-3 * np.sqrt(np.mean(values**2))
    members = Members(
        {kind: values[None] for kind, values in structure.parameters_like(np.empty(0)).items()},
        np.zeros((1, 40)), np.zeros((0, 20)), 0,
    )  # fmt: skip
    assert np.nanmax(spread_of(members, structure, record, found).displacement) < 1e-9
    slow = with_slow_followers(structure, record.step)
    pushed = structure.parameters["m"].numpy()
    assert (slow.parameters["m"].numpy() > 1.0).any()
    np.testing.assert_allclose(slow.parameters["m"].numpy() * slow.with_ground, pushed * structure.with_ground)


def test_a_motion_that_does_not_stay_finite_is_told():
    structure = small_chain("van_der_pol")
    unstable = structure.with_parameters(mu=-50.0 * structure.parameters["mu"])
    record = measured(structure, samples=129).record
    with pytest.raises(NoFreeRunError, match="the structure is unstable: its free run overflows at "):
        free_run(unstable, record, (REST + 5.0, REST))


def test_what_has_no_free_run_is_said():
    structure, record = small_chain(), measured(small_chain()).record
    massless = structure.with_parameters(m=structure.parameters["m"] * torch.tensor([1.0, 0.0, 1.0]))
    endless = structure.with_parameters(k=structure.parameters["k"] * np.inf)
    unforced = np.array([False, False, True])
    unknown = replace(record, force=record.force + np.array([0.0, np.nan, 0.0]), unforced=unforced)
    for chain, under, said in (
        (massless, record, "a mass of it is zero"),
        (endless, record, "no finite number"),
        (structure, unknown, "the force on DOF 2 is unknown"),
    ):
        with pytest.raises(NoFreeRunError, match=said):
            free_run(chain, under)


def test_a_long_record_is_cut_down_for_a_structure_that_takes_steps():
    record = measured(small_chain(), samples=513).record
    longer = replace(
        record,
        **{name: np.concatenate([getattr(record, name)] * 100) for name in QUANTITIES},
        time=record.step * np.arange(51300.0),
    )
    assert affordable(small_chain("linear"), longer) is longer
    assert affordable(small_chain(), record) is record
    part = affordable(small_chain(), longer)
    assert 100 < len(part.time) < len(longer.time)
