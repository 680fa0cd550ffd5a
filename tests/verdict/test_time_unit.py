"""A time axis in milliseconds, minutes, ...: found by the natural frequencies, and only where they do not fit."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pinn_cli.verdict.chain_faults import time_unit_fault


@pytest.mark.parametrize(("scale", "told"), [(1e3, "milliseconds"), (1 / 60, "minutes")])
def test_a_time_axis_in_another_unit(frame, frame_record, scale, told):
    found = time_unit_fault(frame, replace(frame_record, time=frame_record.time * scale))
    assert found is not None
    assert (found.kind, found.word) == ("time_unit", "failed")
    assert told in found.text


def test_seconds_are_fine(frame, frame_record):
    assert time_unit_fault(frame, frame_record) is None


def test_a_chain_that_fits_in_no_unit(frame, frame_record):
    stiff = frame.with_parameters(k=frame.parameters["k"] * 1e4)
    assert time_unit_fault(stiff, frame_record) is None
