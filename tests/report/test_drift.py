"""Drifts of connections: their peaks against numbers counted by hand, in the table, the dataset and the figure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from small_estimates import make_estimate
from structures import braced

from pinn_cli.record.response import Response
from pinn_cli.report.dataset import response_dataset, write_dataset
from pinn_cli.report.drift import COLUMNS, Drifts, drift_table
from pinn_cli.report.figures.drift import drift_figure
from pinn_cli.report.results import LABELS
from pinn_cli.system import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.system.labels import Labels
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import ConnectionHistories

RUN = dict.fromkeys(LABELS, "x")
TIME = np.linspace(0.0, 10.0, 1001)


def chain(labels: Labels | None = None) -> Structure:
    structure = build_chain(3, Linear(), m=1.0, c=1.0, k=15.0)
    return structure if labels is None else replace(structure, labels=labels)


def motion(scale: float = 1.0) -> np.ndarray:
    """Drifts of 1, 2 and -4 mm at most, at 2, 5 and 8 s."""
    pulses = [scale * 1e-3 * size * np.exp(-((TIME - at) ** 2)) for size, at in ((1, 2), (2, 5), (-4, 8))]
    return np.cumsum(pulses, axis=0).T


def drifts(make_case, labels: Labels | None = None, known=(0, 1, 2)) -> Drifts:
    still = np.zeros((len(TIME), 3))
    response = Response(TIME, motion(1.1), still, still, still)
    true = np.full(still.shape, np.nan)
    true[:, known] = motion()[:, known]
    estimate = replace(make_case().estimate, response=response)
    return Drifts.of(chain(labels), estimate, Response(TIME, true, still, still, still))


def test_peaks_and_their_times(make_case):
    table = drift_table(drifts(make_case), RUN)
    assert list(table) == [*LABELS, *COLUMNS]
    assert table["connection"].tolist() == ["1", "2", "3"]
    np.testing.assert_allclose(table["peak"], [1.1e-3, 2.2e-3, 4.4e-3], rtol=1e-9)
    np.testing.assert_allclose(table["true_peak"], [1e-3, 2e-3, 4e-3], rtol=1e-9)
    np.testing.assert_allclose(table["time_of_peak"], [2.0, 5.0, 8.0])
    np.testing.assert_allclose(table["true_time_of_peak"], [2.0, 5.0, 8.0])
    np.testing.assert_allclose(table["error_percent"], 10.0)
    assert table[["std", "lower_90", "upper_90"]].isna().all(axis=None)


def test_the_interval_is_that_of_the_drift_at_its_peak(make_case):
    spread = np.linspace(1e-4, 1.1e-3, len(TIME))[:, None] * np.ones(3)
    found = replace(drifts(make_case, Labels(connections=("base", "middle", "brace"))), std=spread)
    table = drift_table(found, RUN)
    assert table["connection"].tolist() == ["base", "middle", "brace"]
    np.testing.assert_allclose(table["std"], [3e-4, 6e-4, 9e-4])
    np.testing.assert_allclose(table["upper_90"], table["peak"] + 1.6448536 * table["std"])
    np.testing.assert_allclose(table["lower_90"], table["peak"] - 1.6448536 * table["std"], atol=1e-12)
    wide = drift_table(replace(found, std=10.0 * spread), RUN)
    assert wide["lower_90"].iloc[1] == 0.0


def test_standard_deviations_are_those_of_the_estimate(make_case):
    still, spread = np.zeros((len(TIME), 3)), np.full((len(TIME), 3), 2e-4)
    response = Response(TIME, motion(), still, still, still)
    connections = ConnectionHistories(chain().elongation(motion()), spread, spread, spread)
    estimate = replace(make_case().estimate, response=response, connections=connections)
    found = Drifts.of(chain(), estimate, Response.unknown(TIME, 3))
    np.testing.assert_array_equal(found.std, spread)
    np.testing.assert_allclose(drift_table(found, RUN)["std"], 2e-4)


def test_the_truth_of_a_drift_takes_both_ends(make_case):
    table = drift_table(drifts(make_case, known=(0, 2)), RUN)
    assert table["true_peak"].notna().tolist() == [True, False, False]
    assert table["true_time_of_peak"].notna().tolist() == [True, False, False]
    assert table["error_percent"].notna().tolist() == [True, False, False]


def test_a_connection_of_a_frame_is_stretched_by_what_it_joins():
    structure = braced()
    response = Response(TIME, *(np.zeros((len(TIME), structure.ndof)) for _ in range(4)))
    shape = np.array([1.0, 2.5, 3.0])
    moved = replace(response, displacement=np.sin(TIME)[:, None] * shape)
    found = Drifts.of(structure, replace(make_estimate().estimate, response=moved), response)
    expected = np.array([1.0, 1.5, 0.5, 2.5, 2.0, 0.8 * 1.0 - 0.6 * 3.0])
    np.testing.assert_allclose(found.estimate[100], np.sin(TIME[100]) * expected, rtol=1e-12)


@pytest.mark.parametrize("labels", [None, Labels(connections=("base", "middle", "brace"))])
def test_histories_are_written_by_connection(make_case, tmp_path, labels):
    case = make_case(ndof=3, samples=len(TIME))
    found = drifts(make_case, labels)
    dataset = response_dataset(case.estimate, case.record, None, case.labels, drifts=found)
    place = write_dataset(dataset, tmp_path / "response.nc")
    with xr.open_dataset(place, engine="h5netcdf") as read:
        assert read["connection"].values.tolist() == list(found.names)
        for name, values in {"drift": found.estimate, "drift_std": found.std, "drift_true": found.true}.items():
            np.testing.assert_array_equal(read[name], values)
            assert read[name].dims == ("time", "connection")
            assert read[name].attrs["units"] == "m"
        brace = read["drift"].sel(connection=found.names[2])
        np.testing.assert_array_equal(brace, found.estimate[:, 2])


def test_the_figure_shows_histories_and_peaks(make_case):
    found = replace(drifts(make_case), std=np.full((len(TIME), 3), 2e-4))
    figure = drift_figure(found)
    histories, peaks = figure.axes[:-1], figure.axes[-1]
    assert [axes.get_ylabel() for axes in histories] == ["connection 1", "connection 2", "connection 3"]
    assert all(len(axes.collections) == 1 for axes in histories)  # the band
    np.testing.assert_allclose(peaks.get_lines()[0].get_xdata(), [1.1, 2.2, 4.4])  # mm
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts == ["truth", "estimate", "95 % band", "peak, 90 % interval"]
    unknown = replace(found, std=np.full_like(found.std, np.nan), true=np.full_like(found.true, np.nan))
    texts = [text.get_text() for text in drift_figure(unknown).legends[0].get_texts()]
    assert texts == ["estimate", "peak"]


def test_many_connections_and_many_periods_are_cut_down():
    time = np.linspace(0.0, 400.0, 40001)
    size = np.linspace(1.0, 2.0, 30)
    histories = 1e-3 * size * np.sin(2.0 * np.pi * time)[:, None] * np.exp(-(((time - 300.0) / 60.0) ** 2))[:, None]
    names = tuple(f"storey_{i}" for i in range(1, 31))
    found = Drifts(time, names, histories, np.full_like(histories, np.nan), np.full_like(histories, np.nan))
    figure = drift_figure(found)
    assert [axes.get_ylabel() for axes in figure.axes[:-1]] == [f"storey_{i}" for i in range(23, 31)]
    first, last = figure.axes[0].get_xlim()
    assert last - first < 30.0
    assert first < 300.0 < last
    assert any("8 of 30 connections" in text.get_text() for text in figure.texts)
