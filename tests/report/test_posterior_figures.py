"""Figures of a sampled posterior: what they show, for few and many parameters and chains."""

from dataclasses import replace

import legends
import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from fake_posteriors import (
    DUFFING,
    LABELS,
    make_predictive,
    make_record,
    make_result,
    make_samples,
    parameters_of,
    true_parameters,
)
from matplotlib.figure import Figure
from small_estimates import make_estimate, results_of

from pinn_cli.report.figures import write_posterior_figures
from pinn_cli.report.figures.posterior import (
    IN_PAIRS,
    force_predictive_figure,
    most_correlated,
    posterior_pairs_figure,
    rank_figure,
    trace_figure,
)
from pinn_cli.report.netcdf import posterior_groups
from pinn_cli.report.parameters import DIAGNOSTICS
from pinn_cli.report.run_report import write_posterior
from pinn_cli.training.estimate import ParameterEstimate

TRUE = true_parameters(4)
TWELVE = [f"{symbol}_{i}" for symbol in ("c", "k", "kappa") for i in range(1, 5)]


def _groups(samples=None, **changes):
    """The draws and the statistics, as ``posterior.nc`` has them, and the parameters."""
    samples = samples or make_samples(**changes)
    parameters = parameters_of(samples)
    groups = posterior_groups(make_result(samples), make_record(), parameters, LABELS)
    return groups["posterior"], groups["sample_stats"], parameters


def _pairs(true=TRUE, **changes):
    draws, _, parameters = _groups(**changes)
    return posterior_pairs_figure(draws, parameters, true)


def _trace(samples=None, **changes):
    draws, statistics, parameters = _groups(samples, **changes)
    return trace_figure(draws, statistics, parameters, len(parameters))


def _notes(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.texts if text.get_text()]


def _drawn(figure: Figure) -> Figure:
    figure.draw_without_rendering()
    return figure


def check_pairs(figure: Figure, size: int) -> None:
    """As many panels as there are pairs; labels of ticks do not overlap."""
    assert len(figure.axes) == size**2
    panels = {_place(panel): panel for panel in figure.axes}
    lowest = [label for i in range(size) for label in panels[size - 1, i].get_xticklabels()]
    leftmost = [label for i in range(1, size) for label in panels[i, 0].get_yticklabels()]
    for labels in (lowest, leftmost):
        boxes = [label.get_window_extent() for label in labels if label.get_text()]
        assert len(boxes) >= size - 1
        assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])


@pytest.mark.parametrize(
    ("names", "chains"),
    [(("k_1",), 1), pytest.param(DUFFING, 4, marks=pytest.mark.slow), pytest.param(TWELVE, 2, marks=pytest.mark.slow)],
)
def test_every_figure_is_drawn(names, chains):
    before = dict(mpl.rcParams)
    draws, statistics, parameters = _groups(names=names, chains=chains, draws=60)
    pairs = _drawn(posterior_pairs_figure(draws, parameters, TRUE))
    assert len(_drawn(trace_figure(draws, statistics, parameters, len(names))).axes) == 2 * len(names)
    assert len(_drawn(rank_figure(draws, parameters, len(names))).axes) == len(names)
    assert dict(mpl.rcParams) == before
    check_pairs(pairs, min(len(names), IN_PAIRS))


def test_pairs_show_truth_correlation_and_units():
    figure = _drawn(_pairs())
    panels = {_place(panel): panel for panel in figure.axes}
    assert panels[2, 4].texts[0].get_text().startswith("\N{MINUS SIGN}0.9")
    assert panels[5, 4].get_xlabel() == r"$\kappa_{1}$ (N/m$^{3}$)"
    assert panels[2, 0].get_ylabel() == "$k_{1}$ (N/m)"
    assert len(panels[4, 2].lines) == 2
    assert len(panels[0, 0].lines) == 1
    assert "true value" in legends.texts(figure)
    assert _notes(figure) == []
    assert panels[4, 2].get_xlim() == panels[2, 2].get_xlim() == panels[5, 2].get_xlim()


def _place(panel) -> tuple[int, int]:
    place = panel.get_subplotspec()
    return place.rowspan.start, place.colspan.start


@pytest.mark.slow
def test_many_parameters_show_the_most_correlated():
    figure = _pairs(names=TWELVE, draws=60)
    assert f"the {IN_PAIRS} of 12 parameters that are most correlated with another" in _notes(figure)
    correlation = np.eye(12)
    correlation[1, 7] = correlation[7, 1] = -0.9
    correlation[3, 11] = correlation[11, 3] = 0.5
    assert most_correlated(correlation, 4) == [1, 3, 7, 11]
    assert most_correlated(correlation, 3) in ([1, 3, 7], [1, 7, 11])
    assert most_correlated(correlation[:3, :3], 4) == [0, 1, 2]


@pytest.mark.slow
def test_draws_that_do_not_move():
    draws = make_samples().draws.copy()
    draws[..., 0] = 1.0
    draws, statistics, parameters = _groups(replace(make_samples(), draws=draws))
    assert len(_drawn(posterior_pairs_figure(draws, parameters, TRUE)).axes) == 25
    assert len(_drawn(trace_figure(draws, statistics, parameters, 6)).axes) == 10
    assert len(_drawn(rank_figure(draws, parameters, 6)).axes) == 5


def test_axes_show_the_truth_unless_it_is_far():
    near, far = (_pairs({"k": np.array([value])}, names=("k_1",)) for value in (15.4, 40.0))
    assert near.axes[0].get_xlim()[1] > 15.4
    assert "true value" in legends.texts(near)
    assert far.axes[0].get_xlim()[1] < 16.0
    assert "true value" not in legends.texts(far)


def test_divergent_iterations_are_marked():
    samples = make_samples(warmup=100)
    samples.statistics["diverging"][1, [10, 20]] = True
    figure = _trace(samples)
    assert "2 divergent" in legends.texts(figure)
    np.testing.assert_array_equal(figure.axes[1].lines[-1].get_xdata(), [111, 121])
    assert legends.texts(_trace()) == [f"chain {i}" for i in range(1, 5)]


@pytest.mark.parametrize("dofs", [1, 2, 8])
def test_force_predictive(dofs):
    record, samples = make_record(dofs), make_samples(forces=dofs)
    figure = _drawn(force_predictive_figure(make_predictive(samples, record), record, samples.force_dofs))
    assert len(figure.axes) == min(dofs, 4)
    assert figure.axes[-1].get_ylabel() == f"DOF {dofs}"
    text = figure.axes[0].texts[0].get_text()
    assert 84 <= int(text.split()[2]) <= 96
    assert set(legends.texts(figure)) == {"observed", "predictive median", "90 % band"}


@pytest.mark.parametrize(
    ("posterior", "drawn"),
    [
        (make_result(make_samples(), make_record(), "12 divergences"), {"trace", "ranks", "fitted_force"}),
        pytest.param(make_result(make_samples(statistics={}, method="laplace")), set(), marks=pytest.mark.slow),
    ],
    ids=["sampled", "closed form"],
)
def test_every_file_is_written(posterior, drawn, tmp_path):
    case = make_estimate(ndof=2)
    estimate = replace(case.estimate, parameters=[ParameterEstimate(p, 1.0) for p in parameters_of(posterior.samples)])
    results = results_of(case, record=make_record(), estimate=estimate, posterior=posterior)
    write_posterior_figures(results, write_posterior(results, tmp_path), tmp_path / "figures")
    names = {f"{name}.{kind}" for name in {"posterior_pairs", *drawn} for kind in ("png", "pdf")}
    assert {path.name for path in (tmp_path / "figures").iterdir()} == names
    assert {path.name for path in tmp_path.iterdir()} == {"posterior.nc", "diagnostics.csv", "figures"}
    assert list(pd.read_csv(tmp_path / "diagnostics.csv")) == [*LABELS, *DIAGNOSTICS]
