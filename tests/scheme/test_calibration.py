"""What is in doubt about sensors: parameters in every scheme, and where the search for them starts."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from independent_records import IndependentRecord
from refusals import refusal
from storeys import RATE, record

from pinn_cli.record.channel import WIDEST_DELAY, WIDEST_GAIN, Calibration, Channel, unknown_calibration
from pinn_cli.record.record import Record
from pinn_cli.scheme.bayesian import Bayesian
from pinn_cli.scheme.calibration import calibrated_starts, sensor_parameters
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.system.parameters import Parameter

BELIEVED = {"gain": Calibration(1.0, 0.05), "offset": Calibration(0.0, 0.1)}


@cache
def exact() -> IndependentRecord:
    """Three storeys, nearly without noise."""
    return record(1, duration=20.0, snr_db=60.0)


def changed(quantity: str, dof: int, gain: float, delay: int, kinds: tuple[str, ...] = ("gain", "delay")) -> Channel:
    """A channel with another gain, so many samples late; both unknown."""
    values = gain * np.roll(getattr(exact().record, quantity)[:, dof], delay)
    time = exact().record.time
    return Channel(
        f"{quantity[0]}{dof + 1}",
        quantity,
        {dof: 1.0},
        time,
        values,
        {kind: unknown_calibration(kind, time, values) for kind in kinds},
    )


def with_channels(*calibrated: Channel) -> Record:
    columns = {q: getattr(exact().record, q).copy() for q in ("acceleration", "force")}
    for channel in calibrated:
        columns[channel.quantity][:, channel.dof] = channel.measured
    return replace(exact().record, calibrated=calibrated, **columns)


def chain(k=1.4e5):
    structure = exact().structure
    return build_chain(3, Linear(), m=structure.m.tolist(), c=structure.c.tolist(), k=np.broadcast_to(k, 3).tolist())


def test_parameters_of_every_channel_in_doubt():
    roof = replace(changed("acceleration", 2, 1.0, 0), key="roof")
    cell = replace(changed("force", 2, 1.0, 0), calibration=BELIEVED, key="cell")
    found = sensor_parameters(with_channels(roof, cell))
    assert [p.name for p in found] == ["gain_roof", "delay_roof", "gain_cell", "offset_cell"]
    assert [p.index for p in found] == [0, 0, 1, 1]
    assert [p.unknown for p in found] == [True, True, False, False]
    assert [p.owner for p in found] == ["sensor roof", "sensor roof", "sensor cell", "sensor cell"]
    assert [p.unit for p in found] == ["", "s", "", "N"]
    assert [p.prior_std for p in found][2:] == [0.05, 0.1]
    assert sensor_parameters(exact().record) == ()


def test_one_gain_must_be_known():
    every = [changed("acceleration", dof, 1.0, 0) for dof in range(3)] + [changed("force", 2, 1.0, 0)]
    believed = [replace(channel, calibration=BELIEVED) for channel in every]
    for doubtful in (every, believed):
        assert refusal(sensor_parameters, with_channels(*doubtful)).startswith(
            "data.channels=gain in doubt on all: must be one channel at least whose"
        )
        sensor_parameters(with_channels(*doubtful[1:]))
        sensor_parameters(with_channels(*doubtful[1:], replace(every[0], calibration={"gain": Calibration(1.1)})))


def test_bayesian_has_a_prior_for_what_is_in_doubt_of_a_sensor():
    problem = Bayesian(unknown=["k_*"]).pose(chain(), [with_channels(changed("acceleration", 0, 1.3, 3))]).alone
    priors = {p.name: p.prior for p in problem.uncertain}
    assert priors["gain_a1"].mean == pytest.approx(1.3, rel=0.03)
    assert (priors["gain_a1"].std, priors["delay_a1"].std) == (WIDEST_GAIN, pytest.approx(WIDEST_DELAY / RATE))
    assert len(problem.priors) == len(problem.uncertain)
    believed = replace(changed("acceleration", 0, 1.0, 0), calibration=BELIEVED)
    priors = {p.name: p.prior for p in Bayesian().pose(chain(), [with_channels(believed)]).alone.uncertain}
    assert (priors["gain_a1"].mean, priors["gain_a1"].std, priors["offset_a1"].std) == (1.0, 0.05, 0.1)


# Channel, DOF, gain, and samples that it is late.
DOUBTFUL = (("acceleration", 0, 1.3, 3), ("acceleration", 2, 0.8, -2), ("force", 2, 1.2, 1))


def test_springs_gains_and_delays_are_found_together():
    """They hide each other, and the guess of the springs is a decade off."""
    doubtful = with_channels(*(changed(*one) for one in DOUBTFUL))
    problem = StateParameter(unknown=["k_*"]).pose(chain(), [doubtful]).alone
    start = {p.name: p.prescribed for p in problem.uncertain}
    for i, k in enumerate(exact().structure.k, 1):
        assert start[f"k_{i}"] == pytest.approx(k, rel=0.05)
    (first, *_) = problem.record.calibrated
    assert first.number("delay").value == start["delay_a1"]
    assert problem.structure.parameters["k"][0] == start["k_1"]
    believed = SparseRecovery().pose(chain(exact().structure.k), [doubtful]).alone
    for found in (start, {p.name: p.prescribed for p in believed.uncertain}):
        for name, (_, _, gain, delay) in zip(("a1", "a3", "f3"), DOUBTFUL, strict=True):
            assert found[f"gain_{name}"] == pytest.approx(gain, rel=0.05)
            assert found[f"delay_{name}"] == pytest.approx(delay / RATE, abs=4e-3)


def test_what_is_believed_stays_where_it_is_believed():
    channel = replace(
        changed("acceleration", 0, 1.0, 0), calibration={**BELIEVED, "delay": Calibration(0.0, 0.05, True)}
    )
    own = with_channels(channel)
    found = {Parameter("gain", 0, label=channel.key): 2.0, Parameter("delay", 0, label=channel.key): 0.02}
    again = calibrated_starts(own, {**found, Parameter("k", 0): 5.0})
    assert (again.calibrated[0].number("gain").value, again.calibrated[0].number("delay").value) == (1.0, 0.02)
    assert calibrated_starts(own, {Parameter("k", 0): 5.0}) is own
