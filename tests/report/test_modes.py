"""``modes.csv`` and its figure: intervals against draws of the parameters, and modes of other structures beside."""

from dataclasses import replace

import numpy as np
import pytest
from small_estimates import make_estimate
from structures import braced

from pinn_cli.report.estimates import ModeEstimates, mode_table
from pinn_cli.report.figures.parameters import interval_text, modes_figure
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.system.parameters import Labels, Parameter
from pinn_cli.training.estimate import Estimate, ParameterEstimate

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
    for every, interval in zip(drawn_modes, (modes.frequency_interval, modes.damping_interval), strict=True):
        drawn = np.quantile(every, (0.05, 0.95), axis=0)
        width = drawn[1] - drawn[0]
        np.testing.assert_allclose(interval / width, drawn / width, atol=0.06)


def test_beside_a_bound_an_interval_is_lopsided():
    structure = build_chain(1, Linear(), m=2.0, c=4.0, k=800.0)
    estimate = estimated(structure, {"c": 0.5})
    beside = replace(estimate.parameters[0], lower_90=3.9, upper_90=8.0)
    modes = ModeEstimates.of(structure, replace(estimate, parameters=[beside]))
    np.testing.assert_allclose(modes.damping_interval[:, 0], np.array([3.9, 8.0]) / (2 * np.sqrt(2.0 * 800.0)))


def test_the_table():
    structure, true = chain(), chain(882.0)
    estimate = estimated(structure, {"k": 0.01})
    table = mode_table(ModeEstimates.of(structure, estimate, true))
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


def test_what_is_not_known_is_empty():
    structure = chain()
    nothing = replace(make_estimate().estimate, parameters=[], correlation=None)
    held = mode_table(ModeEstimates.of(structure, nothing))
    assert held[["lower_90", "upper_90", "true_frequency", "true_mac"]].isna().all(axis=None)
    alone = replace(estimated(structure, {"k": 0.01}), correlation=None)
    assert mode_table(ModeEstimates.of(structure, alone))["lower_90"].isna().all()
    blank = structure.with_parameters(k=structure.parameters["k"] * np.nan)
    table = mode_table(ModeEstimates.of(blank, estimated(structure, {"k": 0.01})))
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


def test_a_sensor_has_no_part_in_it():
    structure = chain()
    estimate = estimated(structure, {"k": 0.01})
    gain = ParameterEstimate(Parameter("gain", 0, 1.0, label="a1"), 1.1, 0.1, 0.9, 1.3)
    beside = replace(estimate, parameters=[gain, *estimate.parameters], correlation=np.eye(4))
    alone, together = (ModeEstimates.of(structure, each) for each in (estimate, beside))
    np.testing.assert_array_equal(alone.frequency_interval, together.frequency_interval)
    np.testing.assert_array_equal(alone.frequencies, together.frequencies)
