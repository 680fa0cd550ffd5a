"""The response in files of other programs: written, and read back as a record of somebody's."""

from itertools import product

import numpy as np
import pytest
from small_estimates import results_of

from pinn_cli.record.files.csv import CsvFormat
from pinn_cli.record.files.excel import ExcelFormat
from pinn_cli.record.files.mat import MatFormat
from pinn_cli.record.files.uff import UffFormat
from pinn_cli.record.response import QUANTITIES
from pinn_cli.report.export import EXPORTS, report_settings
from pinn_cli.report.netcdf import response_dataset
from pinn_cli.settings.errors import InputError
from pinn_cli.system.quantities import UNITS


@pytest.fixture
def case(make_case):
    return make_case(ndof=3, observed=2)


@pytest.fixture
def dataset(case):
    return response_dataset(results_of(case))


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
