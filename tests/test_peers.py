"""What `make bench-peers` counts and hands on; the peers themselves are not installed here."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from benchmarks.peers.__main__ import HERE, PEERS, fitness, lines_written, modal_errors, settings_tuned, write_record

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
