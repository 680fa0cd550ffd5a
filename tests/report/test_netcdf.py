"""The response in response.nc and in files of other programs, and the posterior as ArviZ reads it."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import xarray as xr
from fake_posteriors import DUFFING, LABELS, make_record, make_result, make_samples, parameters_of
from small_estimates import results_of

from pinn_cli.record.files.csv import CsvFormat
from pinn_cli.record.files.excel import ExcelFormat
from pinn_cli.record.files.mat import MatFormat
from pinn_cli.record.files.uff import UffFormat
from pinn_cli.record.record import Truth
from pinn_cli.record.response import QUANTITIES, RESPONSE_QUANTITIES, Response
from pinn_cli.report.export import EXPORTS, report_settings
from pinn_cli.report.netcdf import (
    netcdf_attributes,
    posterior_groups,
    response_dataset,
    write_dataset,
)
from pinn_cli.settings.errors import InputError
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.quantities import UNITS

arviz = pytest.importorskip("arviz")


@pytest.fixture
def case(make_case):
    return make_case(ndof=3, observed=2)


@pytest.fixture
def dataset(case):
    return response_dataset(results_of(case))


@pytest.fixture
def read(dataset, tmp_path):
    place = write_dataset(dataset, tmp_path / "response.nc")
    assert list(tmp_path.iterdir()) == [place]
    with xr.open_dataset(place, engine="h5netcdf") as written:
        yield written


def test_every_quantity_comes_in_four_with_its_labels(case, read):
    for quantity in QUANTITIES:
        sources = {"": case.estimate.response, "_std": case.estimate.std, "_true": case.truth.response}
        for suffix, source in sources.items():
            np.testing.assert_array_equal(read[quantity + suffix], getattr(source, quantity))
            assert read[quantity + suffix].dims == ("time", "dof")
            assert read[quantity + suffix].attrs["units"] == UNITS[quantity]
    np.testing.assert_array_equal(read["acceleration_observed"], case.record.acceleration)
    assert read["displacement_observed"].isnull().all()
    # The zeros of unforced DOFs are knowledge, not measurements.
    assert read["force_observed"].notnull().all("time").values.tolist() == [True, False, False]
    assert read["dof"].values.tolist() == [1, 2, 3]
    np.testing.assert_array_equal(read["time"], case.record.time)
    assert read["observed"].values.tolist() == [True, True, False]
    assert read["unforced"].values.tolist() == [False, True, True]
    assert (read.attrs["case"], read.attrs["ndof"]) == ("small", 3)
    assert netcdf_attributes({"a": None, "b": False, "c": "x"}) == {"b": 0, "c": "x"}


def test_a_free_run_is_of_the_motion_only_and_what_is_unknown_is_left_out(make_case):
    case = make_case(ndof=2, observed=1)
    free = case.truth.response
    dataset = response_dataset(results_of(case, baseline=case.estimate), free)
    for quantity in RESPONSE_QUANTITIES:
        np.testing.assert_array_equal(dataset[f"{quantity}_free_run"], getattr(free, quantity))
        assert dataset[f"{quantity}_kalman_smoother"].attrs["units"] == UNITS[quantity]
        assert dataset[f"{quantity}_kalman_smoother_std"].shape == dataset[quantity].shape
    assert "force_free_run" not in dataset
    nothing = Truth(Response.unknown(case.record.time, 2), None)
    dataset = response_dataset(results_of(case, truth=nothing))
    assert not [name for name in dataset if str(name).endswith(("_true", "_free_run"))]


def read_back(result, record, path, labels=LABELS):
    groups = posterior_groups(result, record, parameters_of(result.samples), labels)
    return arviz.from_netcdf(write_dataset(xr.DataTree.from_dict(groups), path / "posterior.nc"))


def test_arviz_reads_every_group(tmp_path):
    samples, record = make_samples(forces=2), make_record()
    result = make_result(samples, record)
    data = read_back(result, record, tmp_path)
    assert set(data.groups()) == {"posterior", "prior", "posterior_predictive", "observed_data", "sample_stats"}
    assert list(data.posterior.data_vars) == [*DUFFING, "sigma_force"]
    np.testing.assert_array_equal(data.posterior["kappa_2"], samples.draws[..., 5])
    np.testing.assert_array_equal(data.posterior["force_dof"], [1, 2])
    assert dict(data.prior.sizes) == {"chain": 1, "draw": 500}
    np.testing.assert_array_equal(data.sample_stats["lp"], samples.statistics["lp"])
    assert (arviz.summary(data, var_names=list(DUFFING), kind="diagnostics")["r_hat"] < 1.05).all()
    predicted, observed = data.posterior_predictive["force"], data.observed_data["force"]
    assert predicted.dims == ("chain", "draw", "time", "dof")
    np.testing.assert_allclose(predicted, result.predictive.force, rtol=1e-6)
    np.testing.assert_array_equal(predicted["draw"], np.arange(0, 200, 10))
    np.testing.assert_array_equal(observed, record.force[::2])
    np.testing.assert_array_equal(observed["time"], record.time[::2])


def test_the_force_on_the_last_dof_is_its_own_column(tmp_path):
    record = make_record(dofs=3)
    samples = replace(make_samples(), force_dofs=np.array([3]))
    data = read_back(make_result(samples, record), record, tmp_path)
    np.testing.assert_array_equal(data.observed_data["force"][:, 0], record.force[::2, 2])


def test_units_attributes_and_what_there_is_not(tmp_path):
    result = make_result(make_samples(statistics={}, method="laplace", chains=1))
    data = read_back(result, make_record(), tmp_path, LABELS | {"snr_db": None})
    assert set(data.groups()) == {"posterior", "prior"}
    units = {name: data.posterior[name].attrs["units"] for name in ("c_1", "k_2", "kappa_2", "sigma_force")}
    assert units == {"c_1": "N s/m", "k_2": "N/m", "kappa_2": "N/m^3", "sigma_force": "N"}
    assert (data.attrs["method"], data.attrs["case"]) == ("laplace", "pe")
    assert "snr_db" not in data.attrs
    assert data.posterior.attrs["tuning_steps"] == 100
    groups = posterior_groups(make_result(make_samples(("k_1",))), make_record(), [Parameter("k", 0)], LABELS)
    assert "units" not in groups["posterior"]["k_1"].attrs


def test_every_format_has_every_quantity_of_every_dof(case, dataset, tmp_path):
    pytest.importorskip("pyuff")
    pytest.importorskip("openpyxl")
    for export in EXPORTS.values():
        export.write(dataset, tmp_path / f"response.{export.name}")
    assert sorted(file.suffix for file in tmp_path.iterdir()) == [".csv", ".mat", ".uff", ".xlsx"]
    names = {"csv": "{quantity}_{dof}{_std}", "mat": "{quantity}{_std}.{dof}", "uff": "{quantity} {dof}{ std}"}
    names["excel"] = names["csv"]
    for reader in (CsvFormat(), MatFormat(), UffFormat(), ExcelFormat()):
        expected = {}
        for quantity, dof, (word, source) in product(
            QUANTITIES, (1, 2, 3), (("", case.estimate.response), ("std", case.estimate.std))
        ):
            name = names[reader.name].replace("{_std}", word and "_std").replace("{ std}", word and " std")
            expected[name.format(quantity=quantity, dof=dof)] = quantity, getattr(source, quantity)[:, dof - 1]
        table = reader.read(tmp_path / f"response{reader.suffixes[0]}", {name: name for name in expected})
        for name, (quantity, values) in expected.items():
            np.testing.assert_allclose(table.columns[name], values, rtol=1e-9, atol=1e-11)
            if table.time is not None:
                assert (table.hints[name].unit, table.hints[name].quantity) == (UNITS[quantity], quantity)
        if table.time is not None:
            np.testing.assert_allclose(table.time, case.record.time, rtol=1e-6, atol=1e-9)


def test_a_mat_file_says_what_is_in_it_and_dofs_go_by_their_names(case, dataset, tmp_path):
    from scipy.io import loadmat

    EXPORTS["mat"].write(dataset, tmp_path / "response.mat")
    content = loadmat(tmp_path / "response.mat", simplify_cells=True)
    np.testing.assert_array_equal(content["t"], case.record.time)
    np.testing.assert_array_equal(content["displacement"], case.estimate.response.displacement)
    assert content["dof"].tolist() == ["1", "2", "3"]
    named = dataset.assign_coords(dof_name=("dof", np.array(["roof", "floor", "base"], dtype=object)))
    EXPORTS["csv"].write(named, tmp_path / "response.csv")
    columns = CsvFormat().read(tmp_path / "response.csv").columns
    np.testing.assert_allclose(columns["velocity_floor"], case.estimate.response.velocity[:, 1], rtol=1e-9)
    assert content["units"] == {**{quantity: UNITS[quantity] for quantity in QUANTITIES}, "t": "s"}


@pytest.mark.parametrize("names", ["csv", ["xls"], [1], {"csv": 1}, None])
def test_what_is_no_list_of_formats(names):
    with pytest.raises(InputError, match=r"^report.export=.*: must be a list of any of csv, mat, uff, xlsx$"):
        report_settings(names)


def test_a_format_whose_package_is_missing_is_told_before_anything_is_estimated(monkeypatch):
    def missing(module: str) -> None:
        raise ModuleNotFoundError(f"No module named {module!r}", name=module)

    monkeypatch.setattr("pinn_cli.report.export.import_module", missing)
    for name, extra in (("uff", "uff"), ("xlsx", "excel")):
        with pytest.raises(InputError, match=rf"^report.export={name}: must be .*; pip install 'pinn-cli\[{extra}\]'$"):
            report_settings([name])
    assert [export.name for export in report_settings(["mat", "csv", "mat"])[0]] == ["mat", "csv"]
