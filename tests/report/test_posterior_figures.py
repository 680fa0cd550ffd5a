"""Figures of a sampled posterior: what they show, for few and many parameters and chains."""

from __future__ import annotations

from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from fake_posteriors import DUFFING, UNITS, make_predictive, make_record, make_samples, true_parameters
from matplotlib.figure import Figure

from pinn_cli.report.figures.force_predictive import PERIODS_SHOWN, force_predictive_figure, predictive_window
from pinn_cli.report.figures.highest_density import grid_density, mass_levels
from pinn_cli.report.figures.parameter_axis import ParameterAxis
from pinn_cli.report.figures.posterior_pairs import PARAMETERS_SHOWN, most_correlated, posterior_pairs_figure
from pinn_cli.report.figures.posterior_trace import rank_figure, ranks, trace_figure

TWELVE = [f"{symbol}_{i}" for symbol in ("c", "k", "kappa") for i in range(1, 5)]


def _texts(figure: Figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def _notes(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.texts if text.get_text()]


def _drawn(figure: Figure) -> Figure:
    figure.draw_without_rendering()
    return figure


@pytest.mark.parametrize("names", [("k_1",), DUFFING, TWELVE], ids=len)
@pytest.mark.parametrize("chains", [1, 4])
def test_every_figure_is_drawn(names, chains):
    before = dict(mpl.rcParams)
    samples = make_samples(names, chains, draws=60)
    panels = min(len(names), PARAMETERS_SHOWN) ** 2
    assert len(_drawn(posterior_pairs_figure(samples, true_parameters(4), UNITS)).axes) == panels
    assert len(_drawn(trace_figure(samples, UNITS)).axes) == len(names)
    assert len(_drawn(rank_figure(samples)).axes) == len(names)
    assert dict(mpl.rcParams) == before


def test_pairs_show_truth_correlation_and_units():
    figure = _drawn(posterior_pairs_figure(make_samples(), true_parameters(), UNITS))
    panels = np.reshape(figure.axes, (6, 6))
    assert panels[2, 4].texts[0].get_text().startswith("\N{MINUS SIGN}0.9")
    assert panels[5, 4].get_xlabel() == r"$\kappa_{1}$ (N/m$^{3}$)"
    assert panels[2, 0].get_ylabel() == "$k_{1}$ (N/m)"
    assert len(panels[4, 2].lines) == 2
    assert len(panels[0, 0].lines) == 1
    assert "true value" in _texts(figure)
    assert _notes(figure) == []
    assert panels[4, 2].get_xlim() == panels[2, 2].get_xlim() == panels[5, 2].get_xlim()


def test_pairs_without_truth():
    figure = posterior_pairs_figure(make_samples(), None)
    assert "true value" not in _texts(figure)
    assert not any(axes.lines for axes in figure.axes)


def test_tick_labels_do_not_overlap():
    for names in (DUFFING, TWELVE):
        figure = _drawn(posterior_pairs_figure(make_samples(names), true_parameters(4), UNITS))
        renderer = figure._get_renderer()
        size = min(len(names), PARAMETERS_SHOWN)
        for row in (-1, 0):
            panels = np.reshape(figure.axes, (size, size))
            labels = panels[-1, :] if row else panels[1:, 0]
            boxes = [
                label.get_window_extent(renderer)
                for axes in labels
                for label in (axes.get_xticklabels() if row else axes.get_yticklabels())
                if label.get_text()
            ]
            assert len(boxes) >= size
            assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])


def test_many_parameters_show_the_most_correlated():
    figure = posterior_pairs_figure(make_samples(TWELVE), true_parameters(4), UNITS)
    assert _notes(figure) == [f"the {PARAMETERS_SHOWN} of 12 parameters that are most correlated with another"]
    correlation = np.eye(12)
    correlation[1, 7] = correlation[7, 1] = -0.9
    correlation[3, 11] = correlation[11, 3] = 0.5
    assert most_correlated(correlation, 4) == [1, 3, 7, 11]
    assert most_correlated(correlation, 3) in ([1, 3, 7], [1, 7, 11])
    assert most_correlated(correlation[:3, :3], 4) == [0, 1, 2]


def test_draws_that_do_not_move():
    draws = make_samples().draws.copy()
    draws[..., 0] = 1.0
    samples = replace(make_samples(), draws=draws)
    _drawn(posterior_pairs_figure(samples, true_parameters(), UNITS))
    _drawn(trace_figure(samples, UNITS))
    _drawn(rank_figure(samples))


def test_axes_show_the_truth_unless_it_is_far():
    values = np.random.default_rng(0).normal(15.0, 0.1, 1000)
    near = ParameterAxis.around("k_1", values, 15.6, UNITS)
    assert near.limits[0] < 15.0 < 15.6 < near.limits[1]
    far = ParameterAxis.around("k_1", values, 40.0, UNITS)
    assert np.isnan(far.true)
    assert far.limits[1] < 16.0


@pytest.mark.parametrize(
    ("scale", "label"),
    [(1.0, "$k_{1}$ (N/m)"), (1e6, "$k_{1}$ ($10^{6}$ N/m)"), (1e-6, "$k_{1}$ ($10^{-6}$ N/m)")],
)
def test_large_and_small_values_have_a_power_of_ten(scale, label):
    values = scale * np.random.default_rng(0).normal(15.0, 0.1, 1000)
    axis = ParameterAxis.around("k_1", values, float("nan"), UNITS)
    assert axis.label == label
    assert 14.0 < axis.limits[0] * axis.factor < 15.0


def test_regions_hold_their_share_of_a_gaussian():
    generator = np.random.default_rng(0)
    x = generator.standard_normal(20000)
    pairs = np.stack([x, 100.0 * (-0.95 * x + np.sqrt(1.0 - 0.95**2) * generator.standard_normal(20000))], axis=1)
    edges = [(-4.0, 4.0), (-400.0, 400.0)]
    across, up, density = grid_density(pairs, *edges, cells=80)
    assert density.sum() == pytest.approx(1.0, abs=0.01)
    levels = mass_levels(density, (0.9, 0.5))
    cells = density[np.searchsorted(across, pairs[:, 0]).clip(0, 79), np.searchsorted(up, pairs[:, 1]).clip(0, 79)]
    assert [np.mean(cells >= level) for level in levels] == pytest.approx([0.9, 0.5], abs=0.06)


def test_smoothing_keeps_a_ridge():
    x = np.random.default_rng(0).standard_normal(4000)
    x_grid, y_grid, density = grid_density(np.stack([x, -x], axis=1), (-4.0, 4.0), (-4.0, 4.0))
    across, up = np.meshgrid(x_grid, y_grid, indexing="ij")
    covariance = np.sum(density * across * up) / np.sqrt(np.sum(density * across**2) * np.sum(density * up**2))
    assert covariance < -0.98


def test_divergent_iterations_are_marked():
    samples = make_samples(warmup=100)
    samples.statistics["diverging"][1, [10, 20]] = True
    figure = trace_figure(samples, UNITS)
    assert "2 divergent" in _texts(figure)
    np.testing.assert_array_equal(figure.axes[0].lines[-1].get_xdata(), [111, 121])
    assert _texts(trace_figure(make_samples(), UNITS)) == [f"chain {i}" for i in range(1, 5)]


def test_shown_parameters_and_their_number():
    samples = make_samples(TWELVE)
    figure = trace_figure(samples, UNITS, shown=["k_2", "kappa_4", "c_1"])
    assert [axes.get_ylabel().split("$")[1] for axes in figure.axes] == ["k_{2}", r"\kappa_{4}", "c_{1}"]
    assert _notes(figure) == ["3 of 12 parameters"]


def test_ranks_are_shared_by_equal_draws():
    np.testing.assert_array_equal(ranks(np.array([[3.0, 1.0], [2.0, 2.0]])), [[4.0, 1.0], [2.5, 2.5]])


def test_a_single_chain_is_compared_with_itself():
    figure = rank_figure(make_samples(chains=1, draws=101))
    assert figure.axes[0].get_ylabel() == "$c_{1}$, half"
    assert list(figure.axes[0].get_yticks()) == [1, 2]


@pytest.mark.parametrize("dofs", [1, 2, 8])
def test_force_predictive(dofs):
    record, samples = make_record(dofs), make_samples(forces=dofs)
    figure = _drawn(force_predictive_figure(make_predictive(samples, record), record, samples.force_dofs))
    assert len(figure.axes) == min(dofs, 4)
    assert figure.axes[-1].get_ylabel().startswith(f"DOF {dofs}:")
    text = figure.axes[0].texts[0].get_text()
    assert 84 <= int(text.split()[2]) <= 96
    assert _texts(figure) == ["observed", "predictive median", "90 % band"]


def test_the_window_of_the_force():
    time = np.linspace(0.0, 100.0, 1000)
    fast, slow = np.sin(2.0 * np.pi * time)[:, None], np.sin(2.0 * np.pi * time / 50.0)[:, None]
    window = predictive_window(fast)
    assert (window.stop - window.start) / 10.0 == pytest.approx(PERIODS_SHOWN, rel=0.1)
    assert 400 < window.start < window.stop < 600
    assert predictive_window(slow) == slice(0, 1000)
