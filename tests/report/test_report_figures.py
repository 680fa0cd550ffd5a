"""Figures: what they show, and that they are written."""

import subprocess
import sys
from dataclasses import replace

import legends
import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from calls import SMALL, PinnRun
from small_estimates import other_estimate, results_of

from pinn_cli.record.record import Truth
from pinn_cli.record.response import QUANTITIES, Response
from pinn_cli.report.figures import save, style, write_figures
from pinn_cli.report.figures.histories import error_map_figure, response_figure, shown_dofs
from pinn_cli.report.figures.parameters import correlation_figure, parameters_figure
from pinn_cli.report.figures.sensors import compared_channels, history_figure
from pinn_cli.report.figures.structure import layout, structure_figure
from pinn_cli.report.figures.style import line_indices
from pinn_cli.report.results import checked_times
from pinn_cli.settings.errors import InputError
from pinn_cli.system.structure import Structure
from pinn_cli.system.topology import build_structure


def test_all_figures_are_written(make_case, tmp_path):
    case = make_case(ndof=2, observed=1)
    before = dict(mpl.rcParams)
    paths = [path for part in range(3) for path in write_figures(results_of(case), tmp_path, part, 3)]
    figures = ("response", "residuals", "error_map", "drift", "modes", "history", "parameters")
    names = [f"{name}.{kind}" for name in figures for kind in ("png", "pdf")]
    assert sorted(path.name for path in paths) == sorted(names)
    assert sorted(path.name for path in (tmp_path / "figures").iterdir()) == sorted(names)
    assert all(path.read_bytes().startswith((b"\x89PNG", b"%PDF")) and path.stat().st_size > 5000 for path in paths)
    assert dict(mpl.rcParams) == before


def test_the_same_figure_gives_the_same_bytes(make_case, tmp_path):
    history = make_case().estimate.history
    first, second = (save(history_figure(history), tmp_path / name, "history") for name in ("a", "b"))
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]


def test_what_is_never_imported():
    code = "import sys, pinn_cli.report.run_report; early = set(sys.modules); import pinn_cli.report.figures; "
    code += "sys.exit(bool(early & {'arviz', 'xarray'}) or 'matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_rows_and_asterisks(make_case):
    case = make_case(ndof=20, observed=7)
    figure = response_figure(results_of(case))
    assert shown_dofs(20) == [0, 1, 18, 19]
    assert shown_dofs(6) == list(range(6))
    labels = [axes.get_ylabel() for axes in figure.axes if axes.get_ylabel()]
    assert labels == ["DOF 1", "DOF 2", "DOF 19*", "DOF 20*"]
    titles = [axes.get_title() for axes in figure.axes[:4]]
    assert [title.split()[0] for title in titles] == [quantity.capitalize() for quantity in QUANTITIES]
    assert titles[2].endswith("(m/s²)")
    assert legends.texts(figure) == ["truth", "estimate", "95 % band", "observations"]


def test_what_is_unknown_is_not_drawn(make_case):
    case = make_case(ndof=3, observed=2)
    velocity = np.where([False, True, False], case.truth.response.velocity, np.nan)
    truth = replace(Response.unknown(case.record.time, 3), velocity=velocity)
    std = Response.unknown(case.record.time, 3)
    figure = response_figure(results_of(case, estimate=replace(case.estimate, std=std), truth=Truth(truth, None)))
    assert set(legends.texts(figure)) == {"truth", "estimate", "observations"}
    panels = np.reshape(figure.axes, (3, 4))
    drawn = [[style.BLACK in {line.get_color() for line in axes.lines} for axes in row] for row in panels]
    assert drawn == [[False] * 4, [False, True, False, False], [False] * 4]


def test_a_long_record_shows_a_hammers_blow(make_case):
    case = make_case(ndof=2, observed=1, samples=20000, duration=2000.0)
    force = case.record.force.copy()
    force[4000, 0] = 1e3 * np.abs(force[:, 0]).max()
    struck = results_of(case)
    struck = replace(struck, record=replace(struck.record, force=force))
    figure = response_figure(struck)
    first, last = figure.axes[0].get_xlim()
    assert first < struck.record.time[4000] < last
    assert 5.0 < last - first < 400.0
    assert any("part of the record from 0 s to 2000 s" in text.get_text() for text in figure.texts)
    chosen = response_figure(replace(struck, shown=(1000.0, 1010.0))).axes[0].get_xlim()
    assert chosen == pytest.approx((1000.0, 1010.0), abs=0.11)


@pytest.mark.parametrize("given", [5, "1, 2", [1, 2, 3], [2, 1], [1, None], [True, 2], [9, 12], [-3, 0]])
def test_seconds_that_a_record_has_not_are_refused(given):
    time = np.linspace(0.0, 8.0, 81)
    with pytest.raises(InputError, match=r"report.between=.*: must be two times .*; the record goes from 0 s to 8 s"):
        checked_times("report.between", given, time)
    assert checked_times("report.between", (7, 20.0), time) == (7.0, 20.0)


def test_a_run_refuses_them_before_it_writes(pinn_run: PinnRun, tmp_path):
    pinn_run(*SMALL, "report.between=[12.5,13]").refused(
        "report.between=[12.5, 13]: must be two times of the record in s"
    )
    assert not (tmp_path / "outputs").exists()


def test_what_an_estimate_was_given_has_no_residuals(make_case):
    case = make_case(ndof=2, observed=1)
    given = replace(case.estimate, response=replace(case.estimate.response, force=case.record.force * (1.0 + 1e-15)))
    quantities = {channel.quantity for channel in compared_channels(given, case.record)}
    assert "acceleration" in quantities
    assert "force" not in quantities
    assert "force" in {channel.quantity for channel in compared_channels(case.estimate, case.record)}


def test_history_of_terms_without_a_value_of_many_iterations_and_of_any_name(tmp_path, recwarn):
    steps = np.arange(5)
    history = pd.DataFrame({"iteration": steps, "loss_physics": 1.0 + steps, "loss_ridge": 0.0 * steps})
    assert legends.texts(history_figure(history)) == ["equation of motion"]
    steps = np.arange(50_000)
    figure = history_figure(pd.DataFrame({"iteration": steps, "loss_physics": np.exp(-steps / 1e4)}))
    assert len(figure.axes) == 1
    assert len(figure.axes[0].lines[0].get_xdata()) <= 1500
    figure = history_figure(pd.DataFrame({"iteration": [1, 2], "loss_physics": [1.0, 2.0]}))
    figure.axes[0].set_ylabel("\N{CJK UNIFIED IDEOGRAPH-4E00}\N{CJK UNIFIED IDEOGRAPH-968E}")
    save(figure, tmp_path, "named")
    assert not [warning for warning in recwarn if "Glyph" in str(warning.message)]


def test_error_map_frames_each_run_of_observed_dofs(make_case):
    case = make_case(ndof=5, observed=5)
    figure = error_map_figure(case.estimate, case.record.keep({"acceleration": [1, 2, 4]}), case.truth.response)
    frames = [patch for patch in figure.axes[0].patches if patch.get_edgecolor() == (1.0, 0.0, 0.0, 1.0)]
    assert [(frame.get_y(), frame.get_height()) for frame in frames] == [(0.5, 2.0), (3.5, 1.0)]


def _identified(case, *unknown):
    """The case's parameters, of which the named ones are unknown, started from two thirds of their value."""
    return [
        other_estimate(p, unknown=True, prescribed=p.prescribed / 1.5) if p.name in unknown else p
        for p in case.estimate.parameters
    ]


def test_unknown_parameters_are_drawn_in_their_units_above_the_prescribed(make_case):
    case = make_case(ndof=4)
    parameters = _identified(case, "k_2", "k_4", "kappa_2")
    figure = parameters_figure(parameters, case.truth.parameters)
    titles = [
        "Stiffness $k$ (N/m)",
        r"Duffing $\kappa$ (N/m$^{3}$)",
        "Damping $c$",
        "Stiffness $k$",
        r"Duffing $\kappa$",
    ]
    assert [axes.get_title() for axes in figure.axes] == titles
    np.testing.assert_allclose(figure.axes[0].lines[0].get_ydata(), 1.01 * 15.0)
    np.testing.assert_array_equal(figure.axes[0].get_xticks(), [2, 4])
    upper, lower = (legends.texts(place) for place in figure.subfigs)
    assert upper == ["truth", "start, off the scale", "estimate, 90 % interval"]
    one_kind = parameters_figure(_identified(case, "k_2", "k_4")[:8], case.truth.parameters)
    assert legends.fit(one_kind)
    assert lower == ["prescribed", "truth", "estimate, 90 % interval"]


def test_parameters_have_their_places_and_scales(make_case):
    springs = [p for p in _identified(make_case(ndof=4), "k_2", "k_4") if p.name in ("k_2", "k_4")]
    figure = parameters_figure([*springs, *(other_estimate(p, kind="m", title="Mass") for p in springs)], None)
    labels = {axes.get_title().split(" ")[0]: axes.get_xlabel() for axes in figure.axes}
    assert labels == {"Stiffness": "Connection $i$", "Mass": "DOF $i$"}
    case = make_case(ndof=4)
    two = [p for p in case.estimate.parameters if p.name in ("k_2", "k_4")]
    far, near = ([other_estimate(p, unknown=True, prescribed=start) for p in two] for start in (40e3, 14.5))
    figure = parameters_figure(far, None)
    assert figure.axes[0].get_ylim()[1] < 17.0
    assert [text.get_text() for text in figure.axes[0].texts] == ["4e+04"]
    assert legends.texts(figure) == ["start, off the scale", "estimate, 90 % interval"]
    figure = parameters_figure(near, None)
    assert figure.axes[0].get_ylim()[0] < 14.5
    assert legends.texts(figure) == ["start", "estimate, 90 % interval"]
    (given,) = [p for p in make_case(ndof=1).estimate.parameters if p.name == "k_1"]
    bounded = other_estimate(given, unknown=True, prescribed=0.0, estimate=0.0, lower_90=0.1, upper_90=2.0)
    axes = parameters_figure([bounded], None).axes[0]
    (segment,) = [path.vertices for lines in axes.collections for path in lines.get_paths() if len(path.vertices)]
    np.testing.assert_allclose(segment[:, 1], [0.1, 2.0])


def test_correlation_has_the_unknown_parameters_first(make_case):
    case = make_case(ndof=2)
    correlation = np.eye(6)
    correlation[0, 3] = correlation[3, 0] = -0.976
    figure = correlation_figure(_identified(case, "k_2"), correlation)
    axes = figure.axes[0]
    names = ["$k_{2}$", "$c_{1}$", "$c_{2}$", "$k_{1}$", r"$\kappa_{1}$", r"$\kappa_{2}$"]
    assert [label.get_text() for label in axes.get_yticklabels()] == names
    shown = axes.images[0].get_array()
    assert shown[0, 1] == shown[1, 0] == -0.976
    assert np.ma.getmaskarray(shown).diagonal().all()
    texts = [text.get_text() for text in axes.texts]
    assert texts[:2] == ["unknown", "prescribed"]
    assert sorted(texts[2:]) == ["0.00"] * 28 + ["\N{MINUS SIGN}0.98"] * 2


def test_decimation_keeps_extremes_and_ends():
    values = np.random.default_rng(0).normal(size=10_007)
    values[[4321, 8765]] = 50.0, -50.0
    kept = line_indices(values, 500)
    assert len(kept) <= 500
    assert {0, 4321, 8765, 10_006} <= set(kept.tolist())
    assert np.all(np.diff(kept) > 0)
    np.testing.assert_array_equal(line_indices(values[:9], 500), np.arange(9))


@pytest.mark.parametrize(
    ("magnitude", "kilo", "expected"),
    [(2.0, True, (1.0, "")), (0.02, False, (1e3, "m")), (3e-5, False, (1e6, "µ")), (1e3, True, (1e-3, "k")),
     (5e9, True, (1e-9, "G")), (1e17, True, (1e-12, "T")), (2e4, False, (1.0, "")), (float("nan"), False, (1.0, ""))],
)  # fmt: skip
def test_unit_prefix(magnitude, kilo, expected):
    assert style.unit_prefix(magnitude, kilo) == expected


def test_the_legend_of_everything_fits_the_page(make_case):
    case = make_case(ndof=2, observed=1, samples=4096)
    baseline = replace(case.estimate, response=case.truth.response)
    figure = response_figure(results_of(case, linear_response=case.truth.response, baseline=baseline))
    assert legends.fit(figure)
    assert len(legends.texts(figure)) == 6
    assert "kalman smoother" in legends.texts(figure)


LINE = {"law": "linear", "c": 1.0, "k": 5.0}
STOREYS = {
    "storey_1": {"between": ["ground", "x1"], **LINE},
    "storey_2": {"between": ["x1", "x2"], **LINE},
    "storey_3": {"between": ["x2", "x3"], **LINE},
}


def frame(**more) -> Structure:
    return build_structure(["x1", "x2", "x3"], {"x1": 2000, "x2": 2000, "x3": 1500}, {**STOREYS, **more})


def truss(floors: int = 5) -> Structure:
    """Two columns in the plane, with beams and diagonals; every node moves across and up."""
    nodes = {(i, j): (f"x{i}{'lr'[j]}", f"y{i}{'lr'[j]}") for i in range(1, floors + 1) for j in (0, 1)}
    bars = {}
    for i in range(floors):
        bars |= {f"column_{i + 1}{'lr'[j]}": ((i, j), (i + 1, j)) for j in (0, 1)}
        bars |= {f"beam_{i + 1}": ((i + 1, 0), (i + 1, 1)), f"diagonal_{i + 1}": ((i, 0), (i + 1, 1))}
    connections = {}
    for name, (a, b) in bars.items():
        along = np.array([b[1] - a[1], b[0] - a[0]]) / np.hypot(b[1] - a[1], b[0] - a[0])
        weights = {
            dof: float(sign * part)
            for node, sign in ((a, -1), (b, 1))
            if node in nodes
            for dof, part in zip(nodes[node], along, strict=True)
            if part
        }
        connections[name] = {"weights": weights, "law": "linear", "c": 1e3, "k": 1e7}
    return build_structure([dof for pair in nodes.values() for dof in pair], 500.0, connections)


def test_storeys_stand_above_each_other_whatever_braces_there_are():
    brace, tie = {"between": ["ground", "x2"], **LINE}, {"between": ["x3", "x1"], **LINE}
    for structure in (frame(), frame(brace=brace, tie=tie)):
        places, _ = layout(structure.incidence.matrix)
        np.testing.assert_array_equal(places, [[0.0, 1.0], [0.0, 2.0], [0.0, 3.0]])


@pytest.mark.parametrize("structure", [frame(), truss()], ids=["frame", "truss"])
def test_masses_do_not_stand_in_each_other_s_place(structure):
    places, _ = layout(structure.incidence.matrix)
    apart = np.abs(places[:, None] - places[None]).max(axis=-1)
    assert apart[~np.eye(len(places), dtype=bool)].min() >= 0.5


def drawn(structure: Structure) -> list[str]:
    return [text.get_text() for text in structure_figure(structure).axes[0].texts]


def test_every_mass_and_every_connection_is_named():
    lever = {"weights": {"x1": 0.8, "x3": -0.6}, "law": "friction", "speed": 0.01, "c": 0, "k": 0, "F_c": 100}
    structure = frame(brace={"between": ["ground", "x2"], **LINE}, lever=lever, twin=STOREYS["storey_1"])
    texts = drawn(structure)
    assert {"x1\n2000 kg", "x2\n2000 kg", "x3\n1500 kg", "0.8", "-0.6", *structure.labels.connections} == set(texts)
    assert legends.texts(structure_figure(structure)) == ["linear", "friction"]
    assert set(truss().labels.connections) <= set(drawn(truss()))


def test_names_of_connections_do_not_meet():
    structure = frame(
        brace={"between": ["ground", "x2"], **LINE}, twin=STOREYS["storey_2"], tie={"between": ["x1", "x3"], **LINE}
    )
    texts = structure_figure(structure).axes[0].texts
    places = np.array([t.get_position() for t in texts if t.get_text() in structure.labels.connections])
    apart = np.abs(places[:, None] - places[None]) / [0.4, 0.15]
    assert apart.max(axis=-1)[~np.eye(len(places), dtype=bool)].min() >= 1.0
