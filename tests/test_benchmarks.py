"""What `make bench`, `make bench-peers` and the judge of models that are nearly right count, fit and hand on."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hydra.core.override_parser.overrides_parser import OverridesParser

from benchmarks.__main__ import exponents
from benchmarks.cases import grid, ring, structure
from benchmarks.nearly_right.__main__ import overlap_percent, rows
from benchmarks.nearly_right.machines import KINDS, machine, measured
from benchmarks.nearly_right.output_error import fitted, missed_percent
from benchmarks.peers.__main__ import HERE, PEERS, fitness, lines_written, modal_errors, settings_tuned, write_record
from benchmarks.scaling_figure import draw


def table() -> pd.DataFrame:
    size = np.array([10.0, 20.0, 40.0])
    own = {"training_cpu_s": 0.1 * size**2, "whole_cpu_s": 3.0 * size, "memory_mib": 50.0 * size**0.5}
    own |= {"gflop": size**3, "gflop_per_s": size, "factorisations": 20, "smoother_cpu_s": [1.0, 4.0, np.nan]}
    chain = pd.DataFrame({"against": "ndof", "ndof": size, "duration_s": 60, "topology": "chain", **own})
    return pd.concat([chain, chain.assign(against="topology", topology="grid")])


def test_exponents_are_slopes_of_logarithms() -> None:
    found = exponents(table()).set_index("against").loc["ndof"]
    expected = {"training_cpu_s": 2.0, "whole_cpu_s": 1.0, "memory_mib": 0.5, "gflop": 3.0, "smoother_cpu_s": 2.0}
    assert {name: found[name] for name in expected} == pytest.approx(expected)


def test_a_ring_and_a_grid_have_the_connections_of_their_kind() -> None:
    assert sorted(ring(3)) == sorted(
        [("ground", "m1"), ("ground", "m2"), ("ground", "m3"), ("m1", "m2"), ("m2", "m3"), ("m3", "m1")]
    )
    assert set(grid(2)) == {("ground", "m1"), ("m1", "m2"), ("ground", "m3"), ("m3", "m4"), ("m1", "m3"), ("m2", "m4")}


def test_the_overrides_are_read_as_a_structure() -> None:
    parsed = OverridesParser.create().parse_overrides(list(structure(grid(2))))
    values = {override.key_or_group: override.value() for override in parsed}
    assert values["system.dofs"] == ["m1", "m2", "m3", "m4"]
    connections = values["system.connections"]
    assert [tuple(each["between"]) for each in connections.values()] == list(grid(2))
    assert {each["law"] for each in connections.values()} == {"duffing"}


def test_the_figure_is_drawn(tmp_path: Path) -> None:
    assert all(place.stat().st_size > 5000 for place in draw(table(), 20.0, tmp_path))


COMPARED = HERE.parents[1] / "docs" / "compared.md"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A directory with a response of two DOFs, one of them measured, and two modes."""
    time = np.round(np.arange(50) / 7, 4)
    truth = np.column_stack([np.sin(time), np.cos(time)])
    seen = np.where([True, False], truth, np.nan)
    variables = {"acceleration_observed": seen, "force_observed": seen}
    for quantity in ("displacement", "velocity", "acceleration"):
        variables |= {f"{quantity}_true": truth, quantity: truth + 0.02}
    dataset = xr.Dataset({k: (("time", "dof"), v) for k, v in variables.items()}, {"time": time, "dof": [1, 2]})
    dataset.to_netcdf(tmp_path / "response.nc", engine="h5netcdf")
    columns = {"frequency": [1.01, 2.0], "true_frequency": [1.0, 2.0]}
    columns |= {"damping_ratio": [0.01, 0.02], "true_damping_ratio": [0.01, 0.02]}
    pd.DataFrame(columns).to_csv(tmp_path / "modes.csv", index=False)
    return tmp_path


def test_peers_are_given_what_was_measured_and_no_truth(run: Path) -> None:
    write_record(run, run / "record.csv")
    record = pd.read_csv(run / "record.csv")
    assert list(record) == ["t", "f1", "a1"]
    assert np.ptp(np.diff(record["t"])) < 1e-12


def test_accuracy(run: Path) -> None:
    assert fitness(run, None) == "99.00 99.00 99.00"
    perfect = np.column_stack([np.sin(time := np.round(np.arange(50) / 7, 4)), np.cos(time)])
    assert fitness(run, dict.fromkeys(("displacement", "velocity", "acceleration"), perfect)).startswith("100.00")
    assert modal_errors(run, None) == "frequency 0.71, damping 0.0"


def test_lines_and_settings_are_counted(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        '"""Two\nlines."""\n\nimport os\n\n# Tuned with the truth.\nONE = 1  # m\nTWO, THREE = 2, 3\n\nprint(ONE)\n'
    )
    assert lines_written(script) == 4
    assert settings_tuned(script) == 3


def test_the_page_has_the_counts_of_the_scripts() -> None:
    rows = re.findall(r"^\| (\w[\w -]*?) .*\| (\d+) \| (\d+) \|$", COMPARED.read_text(encoding="utf-8"), re.MULTILINE)
    counts = [
        (peer.name, lines_written(HERE / peer.script), settings_tuned(HERE / peer.script))
        for peer in PEERS
        if peer.script
    ]
    assert {(name, int(lines), int(tuned)) for name, lines, tuned in rows if name != "pinn-run"} == set(counts)


@pytest.mark.parametrize("number", [1, 4])
def test_a_record_of_the_model_itself_is_fitted_to_the_truth(number: int) -> None:
    truth = measured("none", 0, number)
    half, dt = truth.half, 1.0 / truth.machine.rate
    periods = round(4.0 / truth.machine.frequencies[0] / dt)
    found, _ = fitted(truth.model, truth.guess, truth.force[:half], truth.sensors[:half], dt, periods)
    assert found == pytest.approx(truth.true, rel=0.02)  # the load cell's noise moves dampers by a per cent
    unseen = truth.force[half:], truth.sensors[half:]
    assert missed_percent(truth.model, found, *unseen, dt) < 0.02  # sensors of 40 dB: 0.01


def test_the_peer_s_friction_steps_like_its_linear_chain_without_friction() -> None:
    there = machine(4)
    force = np.sin(np.arange(400) * 0.3) * 100.0
    rubbing = type(there.model)(2, 2, there.sensors, speed=0.1)
    p, still = there.linear[None], np.zeros((1, 4))
    stepped = rubbing.states(np.append(p, [[0.0, 0.0]], axis=1), still, force, 1.0 / there.rate)
    exact = there.model.states(p, still, force, 1.0 / there.rate)
    assert stepped == pytest.approx(exact, abs=2e-3 * np.abs(exact).max())


def test_intervals_overlap_pair_by_pair_and_a_missing_one_counts_nothing() -> None:
    lower, upper = [0.0, 0.5, 3.0, np.nan], [1.0, 2.0, 4.0, np.nan]
    masses = pd.DataFrame({"parameter": "m_1", "lower_90": lower, "upper_90": upper})
    friction = pd.DataFrame({"parameter": "F_c_1", "lower_90": lower, "upper_90": lower})
    assert overlap_percent(pd.concat([masses, friction])) == pytest.approx(100.0 / 3.0)


@pytest.mark.slow
def test_without_an_error_the_program_is_sound_and_runs_as_freely_as_the_fit() -> None:
    found = rows("none", 0, [])
    assert set(found["verdict"]) == {"sound"}
    assert found["missed"][0] < 1.1 * found["fit_missed"][0] + 1e-3
    assert found["estimate"].to_numpy() == pytest.approx(found["true"].to_numpy(), rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["stick_slip", "second_mode", "sliding_mass", "lagging_load_cell"])
def test_what_is_missing_is_what_is_named_first(kind: str) -> None:
    found = rows(kind, 1, [])
    assert set(found["verdict"]) == {"questionable"}
    assert re.search(KINDS[kind].names, found["reasons"][0].partition(" | ")[0], re.IGNORECASE)
