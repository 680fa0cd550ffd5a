"""A channel of a good record is ruined, or a structure is wrong: the fault is named, with its size, and no other.

What a channel says against itself, and what it does not; first samples that are far off.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calls import PinnRun
from frame_records import altered, exchanged, measure
from small_problems import small_chain
from storeys import K, system, written
from storeys import record as storeys_record

from pinn_cli.inspection.inspection import inspect_record
from pinn_cli.inspection.proposal import Said
from pinn_cli.model.knowledge import Misfit
from pinn_cli.record.channels import channels
from pinn_cli.record.free_run import free_run
from pinn_cli.record.record import Record
from pinn_cli.record.response import QUANTITIES
from pinn_cli.record.signal import Signal
from pinn_cli.verdict.channel_faults import channel_faults, first_sample_findings, record_faults
from pinn_cli.verdict.prediction import predicted


def faults(structure, record, excused=()):
    return channel_faults(predicted(structure, record), excused)


def test_a_good_record_has_none(frame, frame_record):
    """Nor has one with much noise or little, of other sensors, or that begins in motion."""
    noisy = [measure(frame, snr_db) for snr_db in (10.0, 60.0)]
    others = [measure(frame, quantity=quantity) for quantity in ("displacement", "velocity")]
    names = ("time", "acceleration", "force", "displacement", "velocity")
    later = replace(frame_record, **{name: getattr(frame_record, name)[500:] for name in names})
    for record in (frame_record, *noisy, *others, later):
        assert faults(frame, record) == []


def other(x):
    return np.random.default_rng(1).normal(size=len(x))


def elsewhere(record):
    """Its sensor on the first floor stands on the second one."""
    return altered(record.keep({"acceleration": (1, 3)}), 1, lambda _: record.acceleration[:, 1])


def alone(record):
    """Its sensor on the first floor, which shows twice as much."""
    return altered(record.keep({"acceleration": [1]}), 1, lambda x: 2.0 * x)


SECOND, ROOF = "acceleration of DOF 2", "force of DOF 3"
RUINED = [
    (lambda r: altered(r, 2, lambda x: x / 9.80665), "unit", SECOND, "1/9.80665"),
    (lambda r: altered(r, 2, lambda x: 1.15 * x), "gain", SECOND, "1.1"),
    (lambda r: altered(r, 2, lambda x: -x), "sign", SECOND, "multiply it by -1"),
    (lambda r: altered(r, 2, lambda x: np.roll(x, 3)), "delay", SECOND, "samples) late"),
    (lambda r: altered(r, 2, lambda x: x + 0.5 * x.std()), "offset", SECOND, "50 % of its rms"),
    (lambda r: altered(r, 2, other), "sensor", SECOND, ""),
    (lambda r: exchanged(r, 1, 3), "swap", "acceleration of DOFs 1 and 3", "1 and 3"),
    (elsewhere, "misplaced", "acceleration of DOF 1", "fits DOF 2"),
    # All channels say the same of the force; a lone one and the force may be wrong, either.
    (lambda r: replace(r, force=r.force / 1000.0), "unit", ROOF, ""),
    (lambda r: replace(r, force=np.roll(r.force, 4, axis=0)), "delay", ROOF, ""),
    (alone, "gain", "acceleration of DOF 1", "the force"),
]


@pytest.mark.parametrize(("ruin", "kind", "suspect", "told"), RUINED)
def test_a_ruined_channel_is_named_with_what_ruined_it(frame, frame_record, ruin, kind, suspect, told):
    (found,) = faults(frame, ruin(frame_record))
    assert (found.kind, found.suspect) == (kind, suspect)
    assert told in found.text


def test_what_leaves_most_of_the_misfit_is_no_cause(frame, frame_record):
    """A law that is left out turns phases, as a delay does, and leaves more than that."""

    def changed(x):
        turned = np.fft.irfft(np.fft.rfft(x) * np.exp(0.1j), len(x))
        return turned + 0.1 * x.std() * np.random.default_rng(0).standard_normal(len(x))

    assert faults(frame, altered(frame_record, 2, changed)) == []
    gain = altered(frame_record, 2, lambda x: 1.15 * x)
    assert faults(frame.with_parameters(k=frame.parameters["k"] * 1.3), gain) == []  # of a wrong structure
    assert faults(frame, gain, [SECOND]) == []  # of a channel that is excused


def test_a_nonlinear_chain_is_simulated():
    structure = small_chain("duffing", 3)
    record = measure(structure, strength=2.0)
    assert faults(structure, record) == []
    (found,) = faults(structure, altered(record, 3, lambda x: 1.15 * x))
    assert (found.kind, found.suspect) == ("gain", "acceleration of DOF 3")


def left_over(prediction, channel):
    """Of the channel, once the response and free decays are taken out, relative."""
    basis = prediction.decays(channel)
    residual = channel.measured - channel.of(prediction.response)
    residual = residual - basis @ (basis.T @ residual)
    return np.linalg.norm(residual) / np.linalg.norm(channel.measured)


@pytest.mark.parametrize("quantity", ["displacement", "velocity", "acceleration"])
@pytest.mark.parametrize("start", [None, ([0.1, 0.2, -0.1], [0.0, 0.3, 0.0])], ids=["rest", "elsewhere"])
def test_the_response_is_that_of_a_simulation_up_to_free_decays(frame, quantity, start):
    record = measure(frame, None, quantity=quantity)
    prediction = predicted(frame, record, start)
    assert all(left_over(prediction, channel) < 1e-5 for channel in channels(record))


def test_a_held_force_has_a_prediction_and_free_motion_that_grows_has_none(frame):
    record = replace(measure(frame, None), intersample="zero_order_hold")
    record = replace(record, acceleration=free_run(frame, record).acceleration)
    assert all(left_over(predicted(frame, record), c) < 1e-9 for c in channels(record))
    assert predicted(frame.with_parameters(c=-0.1 * frame.parameters["c"]), record) is None


def zeros(x):
    return np.where((np.arange(len(x)) // 200) % 4 == 2, 0.0, x)


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        ("clip", lambda x: np.clip(x, -1.5 * x.std(), 1.5 * x.std())),
        ("clip", lambda x: np.minimum(x, 1.5 * x.std())),
        ("dropout", zeros),
        ("mark", lambda x: np.where(np.arange(len(x)) % 900 == 7, -70.0 * x.std(), x)),
        ("offset", lambda x: x + 0.3 * x.std()),
        ("still", lambda x: 0.0 * x),
    ],
)
def test_a_fault_is_seen_without_any_model(frame_record, kind, change):
    record = altered(frame_record, 2, change)
    (found,) = record_faults(record)
    assert (found.kind, found.suspect) == (kind, "acceleration of DOF 2")
    assert found.word == ("failed" if kind == "still" else "questionable")
    assert found.text in notes(record)


def notes(record):
    """What a look at the record says."""
    every = channels(record, ("acceleration", "force"))
    signals = [Signal(channel.name, channel.measured, channel.quantity, channel.where) for channel in every]
    return inspect_record(signals, record.time, Said(), None).notes


@pytest.mark.parametrize("mains", [50.0, 60.0])
def test_hum_is_told_where_nothing_that_acts_has_it(frame_record, mains):
    record = replace(frame_record, time=frame_record.time / frame_record.step / 250.0)
    line = np.sin(2.0 * np.pi * mains * record.time + 1.0)
    humming = altered(record, 2, lambda x: x + 0.5 * x.std() * line)
    (found,) = record_faults(humming)
    assert (found.kind, found.suspect) == ("hum", "acceleration of DOF 2")
    assert f"{mains:g} Hz" in found.text
    machine = record.force + 0.5 * record.force.std(axis=0) * line[:, None]
    assert record_faults(replace(humming, force=machine)) == []


def test_a_copy_of_another_channel_is_named(frame_record):
    record = altered(frame_record, 2, lambda _: frame_record.acceleration[:, 0])
    (found,) = record_faults(record)
    assert (found.kind, found.suspect) == ("copy", "acceleration of DOF 2")
    assert "copy of the acceleration of DOF 1" in found.text
    assert found.text in notes(record)


def test_what_is_no_fault(frame, frame_record):
    for quantity in ("displacement", "velocity", "acceleration"):
        assert record_faults(measure(frame, quantity=quantity)) == []
    for levels in (4, 64, 4096):  # of a coarse converter
        step = np.ptp(frame_record.acceleration[:, 1]) / levels
        assert record_faults(altered(frame_record, 2, lambda x, step=step: step * np.round(x / step))) == []
    wave = np.round(100 * np.sin(0.7 * frame_record.time))
    assert record_faults(altered(frame_record, 2, lambda _: wave)) == []
    record = measure(frame, None)  # rest before the force begins is no dropout
    quiet = {name: np.concatenate((0 * getattr(record, name), getattr(record, name))) for name in QUANTITIES}
    time = record.step * np.arange(2 * len(record.time))
    assert record_faults(replace(record, time=time, **quiet)) == []
    record = measure(frame, quantity="displacement")  # which may have a mean
    assert record_faults(altered(record, 2, lambda x: x + x.std(), "displacement")) == []


def test_what_nothing_holds_may_go_on_and_on(frame_record):
    carried = altered(frame_record, 2, lambda x: x + 0.3 * x.std())
    assert [fault.kind for fault in record_faults(carried, carried=[2])] == ["offset"]
    assert record_faults(carried, carried=[1]) == []


@pytest.mark.parametrize("quantity", ["acceleration", "force"])
def test_the_sensor_and_the_samples_are_named(problem, estimate, quantity):
    assert first_sample_findings(problem.record, estimate) == []
    values = getattr(problem.record, quantity).copy()
    values[:3, 2] += np.array([8.0, -6.0, 4.0]) * values[:, 2].std()
    (found,) = first_sample_findings(replace(problem.record, **{quantity: values}), estimate)
    assert found.text.startswith(
        f"the first 3 samples are far off: the {quantity} of DOF 3 was measured as {values[0, 2]:.3g}"
    )
    assert f"data.start={problem.record.time[3]:.4g})" in found.text
    unsure = replace(estimate.std, **{quantity: np.where(values == values, 5.0 * values.std(), 0.0)})
    assert first_sample_findings(replace(problem.record, **{quantity: values}), replace(estimate, std=unsure)) == []


def test_a_force_that_the_model_leaves_out_at_the_beginning_alone(problem, estimate):
    acting, rng = float(problem.record.force.std()), np.random.default_rng(0)
    history = 0.01 * acting * rng.standard_normal(problem.record.force.shape)

    def told(history: np.ndarray, record: Record = problem.record) -> int:
        misfit = Misfit.of(record.step, history, acting, 0.0)
        return len(first_sample_findings(record, replace(estimate, misfit=misfit)))

    assert told(history) == told(100.0 * history) == 0
    history[:4, 1] += 20.0 * acting
    assert told(history) == 1
    # A model that does not hold elsewhere either, by its force or by its sensors: the beginning is not what is wrong.
    assert told(history + acting) == 0
    quantities = {name: -getattr(problem.record, name) for name in ("displacement", "velocity", "acceleration")}
    assert told(history, replace(problem.record, **quantities)) == 0


@pytest.mark.slow
@pytest.mark.parametrize(("channels", "seed"), [(("a3",), 1), (("f",), 2), (("a1", "a2", "a3"), 1)])
def test_a_record_that_begins_with_wrong_samples(pinn_run: PinnRun, tmp_path: Path, channels, seed) -> None:
    settings = written(storeys_record(seed, duration=20.0, snr_db=40.0).record, tmp_path / "rig.csv")
    table = pd.read_csv(tmp_path / "rig.csv")
    for name in channels:
        table.loc[:2, name] += np.array([8.0, 5.0, -4.0]) * table[name].std()
    table.to_csv(tmp_path / "rig.csv", index=False)
    command = *system(1.05 * K), *settings, "threads=1", "scheme=state_parameter", "scheme.unknown=[k_*]"
    done = pinn_run(*command).done()
    run = done.record
    assert run["verdict"] != "sound"
    assert "samples are far off" in run["reasons"][0]
    again = pinn_run(*command, "data.start=" + run["reasons"][0].rpartition("data.start=")[2].rstrip(")"))
    assert again.record["verdict"] == "sound"
