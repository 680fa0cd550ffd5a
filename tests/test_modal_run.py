"""Modes in a band of a measured record, through the whole program."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from calls import PinnRun
from vibrating_records import Wing, wing, wing_record, write_wing

BAND, INSIDE = "data.band=[4,12]", slice(1, 4)
MODAL = ("system=modal", "scheme=state_parameter", "figures=false")
LINEAR = ("system=linear", "system.ndof=2", "system.m=1", "system.c=1", "system.k=1")


@pytest.fixture(scope="module")
def made() -> Wing:
    return wing(5, 2, (5.19, 6.61, 6.88))


def written(made: Wing, seed: int, folder: Path, *sensors: str) -> tuple[str, ...]:
    """A record of the wing, and the settings that name its columns."""
    path = write_wing(wing_record(made, seed, 16.0), folder / "wing.csv")
    return "data=csv", f"data.path={path}", "data.time=t", *sensors


@pytest.fixture
def columns(made: Wing, tmp_path: Path) -> tuple[str, ...]:
    return written(made, 5, tmp_path, "data.force={1: f}", "data.acceleration={1: a1, 2: a2}")


@pytest.mark.slow
def test_modes_masses_and_motion_of_a_wing(pinn_run: PinnRun, made: Wing, columns: tuple[str, ...]) -> None:
    done = pinn_run(*columns, BAND, *MODAL[:-1], "data.validation={start: 13}").done()
    modes, found = pd.read_csv(done.directory / "modes.csv"), pd.read_csv(done.directory / "parameters.csv")
    np.testing.assert_allclose(modes["frequency"], made.frequencies[INSIDE], rtol=2e-3)
    np.testing.assert_allclose(modes["damping_ratio"], made.ratios[INSIDE], rtol=0.1)
    masses = found.set_index("parameter").loc[[f"m_mode_{i}" for i in (1, 2, 3)]]
    np.testing.assert_allclose(masses["estimate"], 1.0 / made.residues[0, INSIDE], rtol=0.05)
    assert (np.abs(masses["estimate"] - 1.0 / made.residues[0, INSIDE]) < 4.0 * masses["std"]).all()
    shapes = modes["shape_2"] / modes["shape_1"]
    np.testing.assert_allclose(shapes, made.shapes[1, INSIDE] / made.shapes[0, INSIDE], rtol=0.05)
    report = done.record
    assert report["verdict"] == "sound", report["reasons"]
    assert (pd.read_csv(done.directory / "validation.csv")["nmse_percent"] < 5.0).all()
    assert (done.directory / "figures" / "frequency_response.png").exists()


@pytest.mark.slow
def test_a_mode_that_is_left_out_is_named(pinn_run: PinnRun, columns: tuple[str, ...]) -> None:
    done = pinn_run(*columns, BAND, *MODAL, "system.modes=2")
    report = done.record
    assert report["verdict"] != "sound"
    assert any("is in the band and not in the model" in reason for reason in report["reasons"])


@pytest.mark.slow
def test_a_driven_point_without_a_sensor(pinn_run: PinnRun, tmp_path: Path) -> None:
    true = wing(6, 2, (5.19, 6.61, 9.17), driven=False)
    sensors = written(true, 6, tmp_path, "data.force={engine: f}", "data.acceleration={tip: a1, root: a2}")
    done = pinn_run(*sensors, BAND, *MODAL).done()
    found = done.parameters["estimate"]
    largest = np.abs(true.residues[:, INSIDE]).max(axis=0)
    np.testing.assert_allclose([found[f"m_mode_{i}"] for i in (1, 2, 3)], 1.0 / largest, rtol=0.05)
    report = done.record
    assert any("no sensor is where the force acts, at DOF engine" in reason for reason in report["reasons"])


@pytest.mark.parametrize(
    ("said", "told"),
    [
        (("system=modal", "scheme=state_parameter"), "data.band=None: must be given with system=modal"),
        (("system=modal", BAND), "scheme="),
        ((BAND, *LINEAR), "data.band=[4, 12]: must be"),
        ((*MODAL, BAND, "system.modes=[3.0]"), "system.modes=3.0: must be frequencies within data.band=[4, 12]"),
        ((*MODAL, BAND, "system.modes=many"), "system.modes=many: must be null"),
        ((*MODAL, BAND, "system.dofs=3"), "system.dofs=DOF 3: must be points with a sensor or the force"),
        ((*MODAL, BAND, "data.force={1: f, 2: null}"), "data.force="),
        ((*MODAL, "data.band=[6,6.4]"), "data.band=[6.0, 6.4]: must be a band of"),
        ((*MODAL, BAND, "scheme.unknown=[k_*]"), "scheme.unknown="),
    ],
)
def test_what_cannot_be_asked_for(pinn_run, columns, said, told):
    pinn_run(*columns, *said).refused(told)
