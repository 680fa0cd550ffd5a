"""response.nc, written and read back."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from pinn_cli.record.response import QUANTITIES, UNITS, Response
from pinn_cli.report.dataset import response_dataset, write_dataset


@pytest.fixture
def written(make_case, tmp_path):
    case = make_case(ndof=3, observed=2)
    attributes = {**case.labels, "snr_db": None, "resumed": False}
    dataset = response_dataset(case.estimate, case.record, case.truth.response, attributes)
    place = write_dataset(dataset, tmp_path / "response.nc")
    assert list(tmp_path.iterdir()) == [place]
    with xr.open_dataset(place, engine="h5netcdf") as read:
        yield case, read


def test_every_quantity_comes_in_four(written):
    case, read = written
    for quantity in QUANTITIES:
        sources = {"": case.estimate.response, "_std": case.estimate.std, "_true": case.truth.response}
        for suffix, source in sources.items():
            np.testing.assert_array_equal(read[quantity + suffix], getattr(source, quantity))
            assert read[quantity + suffix].dims == ("time", "dof")
            assert read[quantity + suffix].attrs["units"] == UNITS[quantity]
            assert quantity in read[quantity + suffix].attrs["long_name"]


def test_observations_are_nan_without_a_sensor(written):
    case, read = written
    np.testing.assert_array_equal(read["acceleration_observed"], case.record.acceleration)
    assert read["displacement_observed"].isnull().all()
    # The zeros of unforced DOFs are knowledge, not measurements.
    assert read["force_observed"].notnull().all("time").values.tolist() == [True, False, False]


def test_coordinates(written):
    case, read = written
    assert read["dof"].values.tolist() == [1, 2, 3]
    np.testing.assert_array_equal(read["time"], case.record.time)
    assert read["time"].attrs["units"] == "s"
    assert read["observed"].values.tolist() == [True, True, False]
    assert read["unforced"].values.tolist() == [False, True, True]


def test_global_attributes(written):
    _, read = written
    assert (read.attrs["case"], read.attrs["ndof"], read.attrs["resumed"]) == ("small", 3, 0)
    assert "snr_db" not in read.attrs
    assert read.attrs["intersample"] == "band_limited"


def test_a_free_run_is_of_the_motion_only(make_case):
    case = make_case(ndof=2, observed=1)
    free = case.truth.response
    dataset = response_dataset(case.estimate, case.record, None, case.labels, free)
    for quantity in ("displacement", "velocity", "acceleration"):
        np.testing.assert_array_equal(dataset[f"{quantity}_free_run"], getattr(free, quantity))
        assert dataset[f"{quantity}_free_run"].attrs["units"] == UNITS[quantity]
        assert quantity in dataset[f"{quantity}_free_run"].attrs["long_name"]
    assert "force_free_run" not in dataset
    without = response_dataset(case.estimate, case.record, None, case.labels)
    assert not [name for name in without if str(name).endswith("_free_run")]


def test_unknown_truth_is_left_out(make_case):
    case = make_case(ndof=2, observed=1)
    nothing = Response.unknown(case.record.time, 2)
    for truth in (None, nothing):
        dataset = response_dataset(case.estimate, case.record, truth, case.labels)
        assert not [name for name in dataset if str(name).endswith("_true")]
