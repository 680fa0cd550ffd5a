"""Whole runs on structures that a user writes down."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from calls import PinnRun

RECORD = ("simulation.duration=12", "simulation.samples=256", "excitation.band=[0.2,1.5]", "figures=false")
RENAMED = {f"{kind}_{i}": f"{kind}_spring_{i}" for kind in ("c", "k", "kappa") for i in (1, 2, 3)}


def written_chain(law: str, **parameters: float) -> list[str]:
    """Overrides for a chain of three masses, written out."""
    ends = ["ground", "x1", "x2", "x3"]
    values = ", ".join(f"{name}: {value}" for name, value in {"c": 1.0, "k": 15.0, **parameters}.items())
    springs = [
        f"spring_{i}: {{between: [{ends[i - 1]}, {ends[i]}], law: {law}, {values}}}" for i in range(1, len(ends))
    ]
    return [
        "system=structure",
        "system.dofs=[x1,x2,x3]",
        "system.mass=10",
        f"system.connections={{{', '.join(springs)}}}",
    ]


@pytest.mark.slow  # system/test_topology.py compares their parameters and connections
@pytest.mark.parametrize(
    "settings",
    [
        ["scheme=sparse_recovery"],
        ["scheme=state_parameter", "scheme.unobserved=[2]"],
        ["scheme=sparse_recovery", "model_error=perturbed"],
        ["scheme=sparse_recovery", "model_error=linear"],
    ],
    ids=["recovery", "state_parameter", "perturbed", "linear"],
)
def test_a_chain_written_out_gives_the_chain_s_numbers(pinn_run: PinnRun, settings: list[str]) -> None:
    chain = pinn_run("system=duffing", "system.ndof=3", *RECORD, *settings)
    written = pinn_run(*written_chain("duffing", kappa=100.0), *RECORD, *settings)
    assert (chain.status, written.status) == (0, 0), written.err
    for table in ("fitness.csv", "parameters.csv", "residuals.csv"):
        expected, found = (pd.read_csv(run.directory / table) for run in (chain, written))
        if "parameter" in expected:
            expected["parameter"] = expected["parameter"].map(RENAMED)
        if "channel" in expected:
            expected["channel"] = expected["channel"].str.replace("DOF ", "DOF x")
        pd.testing.assert_frame_equal(expected, found, rtol=1e-10, atol=1e-13)
    with (
        xr.open_dataset(chain.directory / "response.nc") as expected,
        xr.open_dataset(written.directory / "response.nc") as found,
    ):
        assert set(expected.data_vars) == set(found.data_vars)
        for name in expected.data_vars:
            size = np.nanmax(np.abs(expected[name]), initial=0.0)
            np.testing.assert_allclose(found[name], expected[name], rtol=1e-10, atol=1e-10 * size)


def test_a_structure_that_nobody_has_written_down_is_one_line(pinn_run: PinnRun) -> None:
    pinn_run("system=structure").refused("system.dofs=[]: must be a list of names of coordinates")


def test_a_setting_of_chains_is_none_of_a_structure(pinn_run: PinnRun) -> None:
    pinn_run(*written_chain("linear"), "system.ndof=3").refused("system.ndof")
