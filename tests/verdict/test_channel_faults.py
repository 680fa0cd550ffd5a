"""One channel of a good record is ruined: the fault is named, with its size, and no other."""

from dataclasses import replace

import numpy as np
import pytest
from frame_records import altered, measure
from small_problems import small_chain

from pinn_cli.verdict.channel_faults import channel_faults
from pinn_cli.verdict.prediction import predicted


def faults(structure, record, excused=()):
    prediction = predicted(structure, record)
    assert prediction is not None
    return channel_faults(prediction, excused)


def test_a_good_record_has_none(frame, frame_record):
    """Nor has one with much noise or little, of other sensors, or that begins in motion."""
    noisy = [measure(frame, snr_db) for snr_db in (10.0, 60.0)]
    others = [measure(frame, quantity=quantity) for quantity in ("displacement", "velocity")]
    names = ("time", "acceleration", "force", "displacement", "velocity")
    later = replace(frame_record, **{name: getattr(frame_record, name)[500:] for name in names})
    for record in (frame_record, *noisy, *others, later):
        assert faults(frame, record) == []


RUINED = {
    "unit": (lambda x: x / 9.80665, "1/9.80665"),
    "gain": (lambda x: 1.15 * x, "1.1"),
    "sign": (lambda x: -x, "multiply it by -1"),
    "delay": (lambda x: np.roll(x, 3), "samples) late"),
    "offset": (lambda x: x + 0.5 * x.std(), "50 % of its rms"),
}


@pytest.mark.parametrize("kind", RUINED)
def test_a_ruined_channel_is_named_with_what_ruined_it(frame, frame_record, kind):
    change, told = RUINED[kind]
    (found,) = faults(frame, altered(frame_record, 2, change))
    assert (found.kind, found.suspect) == (kind, "acceleration of DOF 2")
    assert told in found.text


def test_what_leaves_most_of_the_misfit_is_no_cause(frame, frame_record):
    """A law that is left out turns phases, as a delay does, and leaves more than that."""

    def changed(x):
        turned = np.fft.irfft(np.fft.rfft(x) * np.exp(0.1j), len(x))
        return turned + 0.1 * x.std() * np.random.default_rng(0).standard_normal(len(x))

    assert faults(frame, altered(frame_record, 2, changed)) == []


def test_a_nonlinear_chain_is_simulated():
    structure = small_chain("duffing", 3)
    record = measure(structure, strength=2.0)
    assert faults(structure, record) == []
    (found,) = faults(structure, altered(record, 3, lambda x: 1.15 * x))
    assert (found.kind, found.suspect) == ("gain", "acceleration of DOF 3")


def test_exchanged_sensors(frame, frame_record):
    a = frame_record.acceleration
    (found,) = faults(frame, replace(frame_record, acceleration=a[:, [2, 1, 0]]))
    assert found.kind == "swap"
    assert "DOFs 1 and 3" in found.text


def test_a_sensor_on_another_floor(frame, frame_record):
    two = altered(frame_record.keep({"acceleration": (1, 3)}), 1, lambda _: frame_record.acceleration[:, 1])
    (found,) = faults(frame, two)
    assert (found.kind, found.suspect) == ("misplaced", "acceleration of DOF 1")
    assert "fits DOF 2" in found.text


def test_the_force_is_named_where_all_channels_say_the_same(frame, frame_record):
    (found,) = faults(frame, replace(frame_record, force=frame_record.force / 1000.0))
    assert (found.kind, found.suspect) == ("unit", "force of DOF 3")
    (found,) = faults(frame, replace(frame_record, force=np.roll(frame_record.force, 4, axis=0)))
    assert (found.kind, found.suspect) == ("delay", "force of DOF 3")


def test_with_one_sensor_either_may_be_wrong(frame, frame_record):
    (found,) = faults(frame, altered(frame_record.keep({"acceleration": [1]}), 1, lambda x: 2.0 * x))
    assert found.kind == "gain"
    assert "the force" in found.text


def test_a_sensor_that_measures_something_else(frame, frame_record):
    noise = np.random.default_rng(1).normal(size=len(frame_record.time))
    (found,) = faults(frame, altered(frame_record, 2, lambda _: noise))
    assert (found.kind, found.suspect) == ("sensor", "acceleration of DOF 2")


def test_a_wrong_chain_blames_no_channel(frame, frame_record):
    wrong = frame.with_parameters(k=frame.parameters["k"] * 1.3)
    assert faults(wrong, altered(frame_record, 2, lambda x: 1.15 * x)) == []


def test_a_channel_that_is_excused_is_not_compared(frame, frame_record):
    record = altered(frame_record, 2, lambda x: 1.15 * x)
    assert faults(frame, record, ["acceleration of DOF 2"]) == []
