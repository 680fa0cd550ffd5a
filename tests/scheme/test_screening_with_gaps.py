"""Stiffnesses that are screened with channels that miss samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from independent_records import frame_record

from pinn_cli.record.gauge import Gauge
from pinn_cli.record.record import Record
from pinn_cli.scheme.screening import screened

STRETCH = np.eye(3) - np.eye(3, k=-1)


def lost(record: Record, seed: int = 0) -> Record:
    """Half of the first sensor's samples, four of five of the second's and a fifth of the third's in one piece."""
    rng, count = np.random.default_rng(seed), len(record.time)
    there = np.ones((count, 3), bool)
    there[:, 0] = rng.random(count) < 0.5
    there[:, 1] = np.arange(count) % 5 == 0
    there[int(0.5 * count) : int(0.7 * count), 2] = False
    gauges = tuple(
        Gauge(f"a{i + 1}", "acceleration", {i: 1.0}, record.time[there[:, i]], record.acceleration[there[:, i], i])
        for i in range(3)
    )
    columns = np.stack([gauge.history(record.time) for gauge in gauges], axis=1)
    return replace(record, acceleration=columns, gauges=gauges)


@pytest.fixture(scope="module")
def made():
    return frame_record(rate=100.0, duration=20.0, cubic=False)


def best_of(record: Record, made) -> np.ndarray:
    known = {"m": made.structure.m, "c": made.structure.c, "k": np.full(3, np.nan)}
    guess = {"m": made.structure.m, "k": np.full(3, 2e5)}
    return screened(record, STRETCH, known, guess)[0].parameters["k"] / made.structure.k


def test_stiffnesses_are_found_from_the_samples_that_are_there(made):
    assert np.abs(best_of(lost(made.record), made) - 1.0).max() < 0.1
    # Straight lines through what is missing lead astray.
    assert np.abs(best_of(replace(lost(made.record), gauges=()), made) - 1.0).max() > 0.5


def test_a_load_cell_that_misses_samples_tells_stiffnesses_too(made):
    record = made.record
    there = np.random.default_rng(3).random(len(record.time)) < 0.6
    cell = Gauge("f", "force", {2: 1.0}, record.time[there], record.force[there, 2])
    force = record.force.copy()
    force[:, 2] = cell.history(record.time)
    assert np.abs(best_of(replace(record, force=force, gauges=(cell,)), made) - 1.0).max() < 0.05
