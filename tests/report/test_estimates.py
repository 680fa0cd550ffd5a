"""What is told of connections and modes: drifts, energy, forces that are left out, intervals."""

from dataclasses import replace

import legends
import numpy as np
import pandas as pd
import pytest
from small_estimates import Case, make_estimate, results_of
from structures import braced, hysteretic

from pinn_cli.model.knowledge import Misfit
from pinn_cli.record.record import Truth
from pinn_cli.record.response import Response
from pinn_cli.record.simulation import simulate
from pinn_cli.report.estimates import (
    Histories,
    ModeEstimates,
    dissipated,
    dissipated_energy,
    drift_table,
    drifts,
    energy_table,
)
from pinn_cli.report.figures.connections import Discrepancy, discrepancy_figure, drift_figure
from pinn_cli.report.figures.parameters import interval_text, modes_figure
from pinn_cli.report.netcdf import response_dataset
from pinn_cli.report.results import Results
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing, Linear
from pinn_cli.system.parameters import Labels, Parameter
from pinn_cli.training.estimate import ConnectionHistories, Estimate, ParameterEstimate

TIME = np.linspace(0.0, 10.0, 1001)
STILL = np.zeros((len(TIME), 3))
CHAIN = build_chain(3, Linear(), m=1.0, c=1.0, k=15.0)
NAMED = replace(CHAIN, labels=Labels(connections=("base", "middle", "brace")))


def motion(scale: float = 1.0) -> np.ndarray:
    """Drifts of 1, 2 and -4 mm at most, at 2, 5 and 8 s."""
    pulses = [scale * 1e-3 * size * np.exp(-((TIME - at) ** 2)) for size, at in ((1, 2), (2, 5), (-4, 8))]
    return np.cumsum(pulses, axis=0).T


def found(structure=CHAIN, known=(0, 1, 2), std: np.ndarray | None = None) -> Histories:
    """Drifts that are estimated a tenth too large."""
    true = np.full(STILL.shape, np.nan)
    true[:, known] = motion()[:, known]
    connections = None if std is None else ConnectionHistories(STILL, std, std, std)
    response = Response(TIME, motion(1.1), STILL, STILL, STILL)
    estimate = replace(make_estimate().estimate, response=response, connections=connections)
    return drifts(structure, estimate, Response(TIME, true, STILL, STILL, STILL))


def test_peaks_of_drifts_their_times_and_intervals():
    table = drift_table(found())
    assert table["connection"].tolist() == ["1", "2", "3"]
    np.testing.assert_allclose(table["peak"], [1.1e-3, 2.2e-3, 4.4e-3], rtol=1e-9)
    np.testing.assert_allclose(table["true_peak"], [1e-3, 2e-3, 4e-3], rtol=1e-9)
    np.testing.assert_allclose(table["time_of_peak"], [2.0, 5.0, 8.0])
    np.testing.assert_allclose(table["true_time_of_peak"], [2.0, 5.0, 8.0])
    np.testing.assert_allclose(table["error_percent"], 10.0)
    assert table[["std", "lower_90", "upper_90"]].isna().all(axis=None)
    table = drift_table(found(known=(0, 2)))  # the truth of a drift takes both ends
    for name in ("true_peak", "true_time_of_peak", "error_percent"):
        assert table[name].notna().tolist() == [True, False, False]
    spread = np.linspace(1e-4, 1.1e-3, len(TIME))[:, None] * np.ones(3)
    table = drift_table(found(NAMED, std=spread))
    assert table["connection"].tolist() == ["base", "middle", "brace"]
    np.testing.assert_allclose(table["std"], [3e-4, 6e-4, 9e-4])
    np.testing.assert_allclose(table["upper_90"], table["peak"] + 1.6448536 * table["std"])
    np.testing.assert_allclose(table["lower_90"], table["peak"] - 1.6448536 * table["std"], atol=1e-12)
    assert drift_table(found(std=10.0 * spread))["lower_90"].iloc[1] == 0.0


def test_a_connection_of_a_frame_is_stretched_by_what_it_joins():
    structure = braced()
    response = Response(TIME, *(np.zeros((len(TIME), structure.ndof)) for _ in range(4)))
    moved = replace(response, displacement=np.sin(TIME)[:, None] * np.array([1.0, 2.5, 3.0]))
    stretched = drifts(structure, replace(make_estimate().estimate, response=moved), response)
    expected = np.array([1.0, 1.5, 0.5, 2.5, 2.0, 0.8 * 1.0 - 0.6 * 3.0])
    np.testing.assert_allclose(stretched.of("estimate")[100], np.sin(TIME[100]) * expected, rtol=1e-12)


@pytest.mark.parametrize("structure", [CHAIN, NAMED])
def test_histories_are_written_by_connection(structure):
    case, stretched = make_estimate(ndof=3, samples=len(TIME)), found(structure)
    record = replace(case.record, time=TIME)
    response = Response(TIME, motion(1.1), STILL, STILL, STILL)
    truth = Truth(Response(TIME, motion(), STILL, STILL, STILL), None)
    estimate = replace(case.estimate, response=response)
    dataset = response_dataset(results_of(case, prescribed=structure, estimate=estimate, record=record, truth=truth))
    assert dataset["connection"].values.tolist() == list(stretched.places)
    for name, source in (("drift", "estimate"), ("drift_std", "std"), ("drift_true", "true")):
        np.testing.assert_allclose(dataset[name], stretched.of(source), atol=1e-15)
        assert dataset[name].dims == ("time", "connection")
        assert dataset[name].attrs["units"] == "m"


def test_the_figure_of_drifts_shows_histories_and_peaks_of_the_largest():
    figure = drift_figure(found(std=np.full(STILL.shape, 2e-4)))
    histories, peaks = figure.axes[:-1], figure.axes[-1]
    assert [axes.get_ylabel() for axes in histories] == ["connection 1", "connection 2", "connection 3"]
    assert all(len(axes.collections) == 1 for axes in histories)  # the band
    np.testing.assert_allclose(peaks.get_lines()[0].get_xdata(), [1.1, 2.2, 4.4])  # mm
    assert peaks.get_xlim() == (0.0, pytest.approx(1.06 * max(line.get_xdata()[-1] for line in peaks.get_lines())))
    assert legends.texts(figure) == ["truth", "estimate", "95 % band", "peak, 90 % interval"]
    assert legends.texts(drift_figure(found(known=()))) == ["estimate", "peak"]
    time, size = np.linspace(0.0, 400.0, 40001), np.linspace(1.0, 2.0, 30)
    waves = 1e-3 * size * np.sin(2.0 * np.pi * time)[:, None] * np.exp(-(((time - 300.0) / 60.0) ** 2))[:, None]
    names = tuple(f"storey_{i}" for i in range(1, 31))
    figure = drift_figure(Histories("drift", "connection", names, time, {"estimate": waves}))
    assert [axes.get_ylabel() for axes in figure.axes[:-1]] == [f"storey_{i}" for i in range(23, 31)]
    first, last = figure.axes[0].get_xlim()
    assert last - first < 30.0
    assert first < 300.0 < last
    assert any("8 of 30" in text.get_text() for text in figure.texts)


def test_a_damper_under_a_sine():
    structure = build_chain(2, Duffing(), m=1.0, c=[2.0, 3.0], k=15.0, kappa=100.0)
    time = np.linspace(0.0, 5.0, 2001)
    u = np.outer(np.sin(2.0 * np.pi * time), [0.1, 0.3])
    v = 2.0 * np.pi * np.outer(np.cos(2.0 * np.pi * time), [0.1, 0.3])
    # pi c omega X^2 a cycle, five of them; springs give back what they take.
    expected = 5 * np.pi * np.array([2.0, 3.0]) * 2.0 * np.pi * np.array([0.1, 0.2]) ** 2
    np.testing.assert_allclose(dissipated(structure, Response(time, u, v, 0 * u, 0 * u)), expected)


@pytest.mark.parametrize("structure", [braced(), hysteretic()], ids=["braced", "hysteretic"])
def test_work_of_the_force_is_dissipated_where_the_motion_has_died_away(structure):
    n, time = structure.ndof, np.linspace(0.0, 120.0, 2401)

    def force(t: np.ndarray) -> np.ndarray:
        return np.outer(np.exp(-(((t - 10.0) / 3.0) ** 2)) * np.sin(1.5 * t), np.arange(n) == n - 1) * 2.0

    response = simulate(structure, force, time, substeps=1)
    work = np.trapezoid(np.sum(force(time) * response.velocity, axis=1), time)
    assert work > 0.1
    # A hidden force that is left over holds a spring bent: that much is stored.
    e = structure.elongation(response.displacement[-1])
    p = structure.parameters_like(e)
    left = 0.5 * np.sum(p["k"] * e**2)
    stored = 0.0 if response.hidden is None else 0.5 * np.sum(response.hidden[-1] ** 2 / p["A"])
    np.testing.assert_allclose(dissipated(structure, response).sum() + left + stored, work, rtol=2e-3)


def test_the_table_of_energy():
    case = make_estimate(ndof=3)
    blank = np.zeros_like(case.record.force)
    known = ConnectionHistories(*[blank] * 4, np.array([1.0, 2.0, 1.0]), np.array([0.1, 0.1, 0.2]))
    results = results_of(case, estimate=replace(case.estimate, connections=known, parameters=[]))
    table = energy_table(dissipated_energy(replace(results, true=results.prescribed)))
    np.testing.assert_allclose(table["share_percent"], [25.0, 50.0, 25.0])
    np.testing.assert_allclose(table["upper_90"] - table["dissipated"], 1.6448536 * np.array([0.1, 0.1, 0.2]))
    np.testing.assert_allclose(table["true"], dissipated(results.prescribed, case.truth.response))
    alone = results_of(case, estimate=replace(case.estimate, parameters=[]))
    table = energy_table(dissipated_energy(alone))
    np.testing.assert_allclose(table["dissipated"], dissipated(alone.prescribed, case.estimate.response))
    assert table[["std", "lower_90", "true", "error_percent"]].isna().all(axis=None)


def without(case: Case, friction: float, acting: float = 1.0) -> Results:
    """Of a chain of three whose second connection rubs, N; and whose motion is a swept sine."""
    time = case.record.time
    phase = 2.0 * np.pi * (10.0 + 2.0 * time / time[-1]) * time / time[-1]
    e = np.sin(phase)[:, None] * np.array([0.01, 0.02, 0.01])
    force = friction * np.sign(np.gradient(e[:, 1]))
    # What the coordinates feel beside the law and the inputs: B' r with the other sign.
    misfit = Misfit.of(case.record.step, np.column_stack((force, -force, 0.0 * force)), acting, 0.0)
    none = np.zeros_like(e)
    known = ConnectionHistories(e, none, none, none)
    estimate = replace(case.estimate, misfit=misfit, connections=known, parameters=[])
    return results_of(case, prescribed=CHAIN, estimate=estimate)


def test_what_is_left_out_is_that_of_the_connection_that_lacks_most(make_case):
    lacking = Discrepancy.of(without(make_case(ndof=3), 0.2))
    assert lacking is not None
    assert lacking.connection == "2"
    assert np.median(np.abs(lacking.force)) == pytest.approx(0.2, rel=0.01)
    assert lacking.explained_by(lacking.velocity)[2] > 0.8
    assert lacking.explained_by(lacking.elongation)[2] < 0.2
    assert np.corrcoef(lacking.force, np.sign(lacking.velocity))[0, 1] == pytest.approx(1.0, abs=0.02)
    assert len(discrepancy_figure(lacking).axes) == 4
    assert Discrepancy.of(without(make_case(ndof=3), 0.2, acting=1e3)) is None


Z = 1.6448536269514722


def chain(k: float = 800.0):
    return build_chain(3, Linear(), m=2.0, c=4.0, k=k)


def estimated(structure, std: dict[str, float], correlation: np.ndarray | None = None) -> Estimate:
    """Parameters where they are in the structure, with relative deviations by kind."""
    found = [
        ParameterEstimate(p, p.prescribed, s, p.prescribed - Z * s, p.prescribed + Z * s)
        for p in structure.every_parameter()
        if (s := std.get(p.kind, 0.0) * p.prescribed)
    ]
    correlation = np.eye(len(found)) if correlation is None else correlation
    return replace(make_estimate().estimate, parameters=found, correlation=correlation)


def test_intervals_are_those_of_draws():
    random, structure = np.random.default_rng(0), chain()
    mixed = random.standard_normal((6, 6)) + 2.0 * np.eye(6)
    covariance = mixed @ mixed.T
    unit = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(unit, unit)
    estimate = estimated(structure, {"k": 0.02, "c": 0.05}, correlation)
    modes = ModeEstimates.of(structure, estimate, structure)
    std = np.array([p.std for p in estimate.parameters])
    draws = random.multivariate_normal(np.zeros(6), correlation * np.outer(std, std), 4000)
    parameters = [p.parameter for p in estimate.parameters]
    moved = np.array([p.estimate for p in estimate.parameters]) + draws
    c, k = (moved[:, [p.kind == kind for p in parameters]] for kind in ("c", "k"))
    B = structure.incidence.matrix.toarray()
    C, K = (np.einsum("ci,dc,cj->dij", B, x, B) / 2.0 for x in (c, k))
    top = np.broadcast_to(np.hstack((np.zeros((3, 3)), np.eye(3))), (len(moved), 3, 6))
    poles = np.linalg.eigvals(np.concatenate((top, np.concatenate((-K, -C), axis=2)), axis=1))
    poles = np.sort_complex(1j * poles)[:, :3]  # those above the real axis, the fastest first
    poles = -1j * poles[:, ::-1]
    drawn_modes = (np.abs(poles) / (2.0 * np.pi), -poles.real / np.abs(poles))
    for every, name in zip(drawn_modes, ("", "damping_ratio_"), strict=True):
        interval = modes.table[[f"{name}lower_90", f"{name}upper_90"]].to_numpy().T
        drawn = np.quantile(every, (0.05, 0.95), axis=0)
        width = drawn[1] - drawn[0]
        np.testing.assert_allclose(interval / width, drawn / width, atol=0.06)


def test_beside_a_bound_an_interval_is_lopsided_and_a_sensor_has_no_part_in_it():
    structure = build_chain(1, Linear(), m=2.0, c=4.0, k=800.0)
    estimate = estimated(structure, {"c": 0.5})
    beside = replace(estimate.parameters[0], lower_90=3.9, upper_90=8.0)
    modes = ModeEstimates.of(structure, replace(estimate, parameters=[beside]))
    ends = modes.table.loc[0, ["damping_ratio_lower_90", "damping_ratio_upper_90"]].to_numpy(float)
    np.testing.assert_allclose(ends, np.array([3.9, 8.0]) / (2 * np.sqrt(2.0 * 800.0)))
    structure = chain()
    estimate = estimated(structure, {"k": 0.01})
    gain = ParameterEstimate(Parameter("gain", 0, 1.0, label="a1"), 1.1, 0.1, 0.9, 1.3)
    beside = replace(estimate, parameters=[gain, *estimate.parameters], correlation=np.eye(4))
    alone, together = (ModeEstimates.of(structure, each).table for each in (estimate, beside))
    pd.testing.assert_frame_equal(alone, together, check_exact=True)


def test_the_table_of_modes():
    structure, true = chain(), chain(882.0)
    estimate = estimated(structure, {"k": 0.01})
    table = ModeEstimates.of(structure, estimate, true).table
    assert list(table)[-3:] == ["shape_1", "shape_2", "shape_3"]
    assert table["mode"].tolist() == [1, 2, 3]
    assert (table["lower_90"] < table["frequency"]).all()
    assert (table["upper_90"] > table["frequency"]).all()
    np.testing.assert_allclose(table["mac"], 1.0)
    np.testing.assert_allclose(table["prescribed_frequency"], table["frequency"])
    np.testing.assert_allclose(table["true_frequency"], 1.05 * table["frequency"])
    np.testing.assert_allclose(table["frequency_error_percent"], 100 * 0.05 / 1.05)
    np.testing.assert_allclose(table["true_damping_ratio"], table["damping_ratio"] / 1.05)
    assert table[["damping_ratio_lower_90"]].notna().all(axis=None)  # zeta goes with 1 / sqrt(k)
    structure = chain()
    nothing = replace(make_estimate().estimate, parameters=[], correlation=None)
    held = ModeEstimates.of(structure, nothing).table
    assert held[["lower_90", "upper_90", "true_frequency", "true_mac"]].isna().all(axis=None)
    alone = replace(estimated(structure, {"k": 0.01}), correlation=None)
    assert ModeEstimates.of(structure, alone).table["lower_90"].isna().all()
    blank = structure.with_parameters(k=structure.parameters["k"] * np.nan)
    table = ModeEstimates.of(blank, estimated(structure, {"k": 0.01})).table
    assert table["prescribed_frequency"].isna().all()
    assert table["frequency"].notna().all()
    assert ModeEstimates.of(blank, nothing) is None


@pytest.mark.parametrize("named", [False, True])
def test_the_figure(named):
    structure = replace(braced(), labels=Labels(("a", "b", "c"), tuple("uvwxyz"))) if named else chain()
    figure = modes_figure(ModeEstimates.of(structure, estimated(structure, {"k": 0.01}), structure))
    titles = [axes.get_title() for axes in figure.axes]
    assert [title.split(":")[0] for title in titles] == ["mode 1", "mode 2", "mode 3"]
    assert all("MAC 1.0000" in title for title in titles)
    names = [text.get_text() for text in figure.axes[0].get_yticklabels()]
    assert names == (["a", "b", "c"] if named else ["1", "2", "3"])
    first = figure.axes[0].get_lines()[-1]
    assert len(first.get_xdata()) == (3 if named else 4)  # a chain's shape begins at the fixed end


@pytest.mark.parametrize(
    ("value", "interval", "text"),
    [
        (2.598, (2.597, 2.599), "2.5980 Hz (2.5970\N{EN DASH}2.5990)"),
        (2.0, (1.0, 13.0), "2 Hz (1\N{EN DASH}13)"),
        (2.5984, (np.nan, np.nan), "2.598 Hz"),
        (np.nan, (np.nan, np.nan), "unknown"),
    ],
)
def test_digits_that_an_interval_leaves(value, interval, text):
    assert interval_text(value, np.array(interval), "Hz") == text
