"""One problem from several records, and what is in doubt about sensors: parameters and where the search starts."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from calls import refusal
from independent_records import IndependentRecord, Structure, measured
from small_problems import accelerations, small_chain
from small_problems import measured as simulated
from storeys import RATE, C, K, M, record, response

from pinn_cli.record.channel import WIDEST_DELAY, WIDEST_GAIN, Calibration, Channel, unknown_calibration
from pinn_cli.record.record import Record
from pinn_cli.scheme.bayesian import Bayesian
from pinn_cli.scheme.calibration import sensor_parameters
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.scheme.starts import Start, calibrated
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.settings.errors import InputError
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.system.parameters import Parameter

CHAIN = small_chain("linear")


def roving(dofs: tuple[int, ...] = (1, 2, 3)) -> list[Record]:
    """A record for every DOF, each with one accelerometer."""
    return [accelerations(simulated(CHAIN, snr_db=40.0, seed=dof).record, (dof,)) for dof in dofs]


def test_believed_parameters_are_one_set_and_every_record_has_its_own_inputs():
    first, second = roving((1, 2))
    second = replace(second, force=np.where(second.unforced, second.force, np.nan))
    problem = SparseRecovery().pose(CHAIN, [first, second])
    one, other = problem
    assert one.uncertain == other.uncertain
    assert [p.prior_std for p in one.uncertain] == [p.prior_std for p in other.uncertain]
    assert one.inputs.forces == ()
    assert other.inputs.forces == (0,)
    assert (one.record, other.record) == (first, second)
    assert len(SparseRecovery().pose(CHAIN, [first])) == 1


def test_a_connection_is_hidden_where_no_record_has_a_sensor():
    def unknown(dofs: tuple[int, ...]) -> list[str]:
        problem = StateParameter(parameter_uncertainty=0.0).pose(CHAIN, roving(dofs))
        (uncertain,) = {p.uncertain for p in problem}
        return [p.name for p in uncertain]

    assert unknown((1,)) == ["k_2", "k_3"]
    assert unknown((1, 2)) == ["k_3"]
    with pytest.raises(InputError, match="every DOF has a sensor"):
        unknown((1, 2, 3))


def test_all_records_start_at_the_same_place_and_so_they_do_elsewhere():
    problem = StateParameter(unknown="k_*", parameter_uncertainty=0.0).pose(CHAIN, roving((1, 3)))
    for start in problem.starts:
        assert len(start) == 2
        assert len({own.structure for own in start}) == 1
        starts = [[p.prescribed for p in own.uncertain] for own in start]
        assert starts[0] == starts[1]


def test_a_roving_accelerometer_is_sensors_enough_for_a_bayesian_scheme():
    problem = Bayesian(unknown="k_*").pose(CHAIN, roving())
    assert len(problem.priors) == 3
    with pytest.raises(InputError, match="there is none on DOF 3"):
        Bayesian(unknown="k_*").pose(CHAIN, roving((1, 2)))


class OneAtATime(SparseRecovery):
    """Somebody's own."""

    name = "own"

    def pose(self, prescribed, records) -> JointProblem:
        return JointProblem.of(Problem(prescribed, self.only_one(records)))


def test_a_scheme_of_ones_own_may_have_one_record_at_a_time():
    records = roving((1, 2))
    assert OneAtATime().pose(CHAIN, records[:1]).alone.record is records[0]
    with pytest.raises(InputError, match=r"data\.records=2 records: must be one record with scheme=own"):
        OneAtATime().pose(CHAIN, records)


def with_channel(record: Record, **calibration: Calibration) -> Record:
    values = record.force[:, 0]
    return replace(record, calibrated=(Channel("f", "force", {0: 1.0}, record.time, values, calibration),))


def test_a_sensor_of_one_name_is_one_sensor():
    unknown, believed = Calibration(1.0, 10.0, unknown=True), Calibration(1.0, 0.1)
    delay = [Calibration(0.0, width, unknown=True) for width in (0.1, 0.2)]
    records = [with_channel(record, gain=unknown, delay=own) for record, own in zip(roving((1, 2)), delay, strict=True)]
    problem = SparseRecovery(parameter_uncertainty=0.0).pose(CHAIN, records)
    widths = [[p.prior_std for p in own.uncertain] for own in problem]
    assert widths == [[10.0, 0.1], [10.0, 0.1]]
    records = [with_channel(record, gain=own) for record, own in zip(roving((1, 2)), (unknown, believed), strict=True)]
    with pytest.raises(InputError, match="gain_f.*the same in all records"):
        SparseRecovery(parameter_uncertainty=0.0).pose(CHAIN, records)


def test_one_gain_of_several_records_is_found_together_with_where_springs_start():
    """Both show one accelerometer in volts: without its gain, springs are read off motions six times smaller."""
    records = []
    for seed in (1, 2):
        made = measured(Structure(M, C, K, np.zeros(3)), response(seed), {"acceleration": (1,)}, 30.0, seed).record
        shown = made.acceleration * [0.16, 1.0, 1.0]
        calibration = {"gain": unknown_calibration("gain", made.time, shown[:, 0])}
        own = Channel("v1", "acceleration", {0: 1.0}, made.time, shown[:, 0], calibration)
        other = Channel("cell", "force", {2: 1.0}, made.time, made.force[:, 2], {})
        channels = (own, other) if seed == 1 else (other, own)  # its number is another one there
        records.append(replace(made, acceleration=shown, calibrated=channels))
    structure = build_chain(3, Linear(), m=M.tolist(), c=C.tolist(), k=1000.0)
    problem = StateParameter(unobserved=[], unknown="k_*").pose(structure, records)
    for one in problem:
        start = {p.name: p.prescribed for p in one.uncertain if p.unknown}
        assert start["gain_v1"] == pytest.approx(0.16, rel=0.05)
        assert [start[f"k_{i}"] for i in (1, 2, 3)] == pytest.approx(K, rel=0.05)
    for one in SparseRecovery().pose(structure.with_parameters(k=torch.as_tensor(K)), records):
        assert {p.name: p.prescribed for p in one.uncertain}["gain_v1"] == pytest.approx(0.16, rel=0.03)


BELIEVED = {"gain": Calibration(1.0, 0.05), "offset": Calibration(0.0, 0.1)}


@cache
def exact() -> IndependentRecord:
    """Three storeys, nearly without noise."""
    return record(1, duration=20.0, snr_db=60.0)


def changed(quantity: str, dof: int, gain: float, delay: int, kinds: tuple[str, ...] = ("gain", "delay")) -> Channel:
    """A channel with another gain, so many samples late; both unknown."""
    values = gain * np.roll(getattr(exact().record, quantity)[:, dof], delay)
    time = exact().record.time
    calibration = {kind: unknown_calibration(kind, time, values) for kind in kinds}
    return Channel(f"{quantity[0]}{dof + 1}", quantity, {dof: 1.0}, time, values, calibration)


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
    found = {Parameter(kind, 0, label=channel.key): Start(x, x) for kind, x in {"gain": 2.0, "delay": 0.02}.items()}
    spring = {Parameter("k", 0): Start(5.0, 5.0)}
    (again,) = calibrated([own], found | spring)
    assert (again.calibrated[0].number("gain").value, again.calibrated[0].number("delay").value) == (1.0, 0.02)
    assert calibrated([own], spring) == [own]
