"""What a channel says against itself, and what it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from frame_records import altered, measure

from pinn_cli.verdict.record_faults import record_faults


def zeros(x):
    return np.where((np.arange(len(x)) // 200) % 4 == 2, 0.0, x)


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        ("clip", lambda x: np.clip(x, -1.5 * x.std(), 1.5 * x.std())),
        ("clip", lambda x: np.minimum(x, 1.5 * x.std())),
        ("dropout", zeros),
        ("offset", lambda x: x + 0.3 * x.std()),
        ("still", lambda x: 0.0 * x),
    ],
)
def test_a_fault_is_seen_without_any_model(frame_record, kind, change):
    (found,) = record_faults(altered(frame_record, 2, change))
    assert (found.kind, found.suspect) == (kind, "acceleration of DOF 2")


def test_a_copy_of_another_channel_is_named(frame_record):
    (found,) = record_faults(altered(frame_record, 2, lambda _: frame_record.acceleration[:, 0]))
    assert (found.kind, found.suspect) == ("copy", "acceleration of DOF 2")
    assert "copy of the acceleration of DOF 1" in found.text


@pytest.mark.parametrize("quantity", ["displacement", "velocity", "acceleration"])
def test_a_good_record_has_none(frame, quantity):
    assert record_faults(measure(frame, quantity=quantity)) == []


@pytest.mark.parametrize("levels", [4, 64, 4096])
def test_a_coarse_converter_is_no_clipping(frame_record, levels):
    step = np.ptp(frame_record.acceleration[:, 1]) / levels
    assert record_faults(altered(frame_record, 2, lambda x: step * np.round(x / step))) == []


def test_a_sine_wave_is_not_clipped(frame_record):
    wave = np.round(100 * np.sin(0.7 * frame_record.time))
    assert record_faults(altered(frame_record, 2, lambda _: wave)) == []


def test_rest_before_the_force_begins_is_no_dropout(frame):
    record = measure(frame, None)
    quiet = {name: np.concatenate((0 * getattr(record, name), getattr(record, name))) for name in (
        "displacement", "velocity", "acceleration", "force")}  # fmt: skip
    time = record.step * np.arange(2 * len(record.time))
    assert record_faults(replace(record, time=time, **quiet)) == []


def test_a_displacement_may_have_a_mean(frame):
    record = measure(frame, quantity="displacement")
    assert record_faults(altered(record, 2, lambda x: x + x.std(), "displacement")) == []
