"""What `posterior.nc` holds, as ArviZ reads it."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from fake_posteriors import DUFFING, LABELS, make_record, make_result, make_samples, parameters_of

from pinn_cli.posterior.result import ForcePredictive
from pinn_cli.report.posterior_data import posterior_groups, write_posterior_data
from pinn_cli.system.parameters import Parameter

arviz = pytest.importorskip("arviz")


def _written(result, record, path):
    return arviz.from_netcdf(
        write_posterior_data(posterior_groups(result, record, parameters_of(result.samples), LABELS), path)
    )


def test_arviz_reads_every_group(tmp_path):
    samples, record = make_samples(forces=2), make_record()
    result = make_result(samples, record)
    data = _written(result, record, tmp_path / "posterior.nc")
    assert set(data.groups()) == {"posterior", "prior", "posterior_predictive", "observed_data", "sample_stats"}
    assert list(data.posterior.data_vars) == [*DUFFING, "sigma_force"]
    assert data.posterior["kappa_2"].dims == ("chain", "draw")
    np.testing.assert_array_equal(data.posterior["kappa_2"], samples.draws[..., 5])
    assert data.posterior["sigma_force"].dims == ("chain", "draw", "force_dof")
    np.testing.assert_array_equal(data.posterior["force_dof"], [1, 2])
    assert dict(data.prior.sizes) == {"chain": 1, "draw": 500}
    assert data.sample_stats["diverging"].dtype == bool
    np.testing.assert_array_equal(data.sample_stats["lp"], samples.statistics["lp"])


def test_arviz_summarises_it(tmp_path):
    record = make_record()
    data = _written(make_result(make_samples()), record, tmp_path / "posterior.nc")
    summary = arviz.summary(data, var_names=list(DUFFING), kind="diagnostics")
    assert list(summary.index) == list(DUFFING)
    assert (summary["r_hat"] < 1.05).all()


def test_the_predicted_force_and_what_was_observed_of_it(tmp_path):
    samples, record = make_samples(forces=2), make_record()
    result = make_result(samples, record)
    data = _written(result, record, tmp_path / "posterior.nc")
    predicted, observed = data.posterior_predictive["force"], data.observed_data["force"]
    assert predicted.dims == ("chain", "draw", "time", "dof")
    assert predicted.shape == (4, 20, 200, 2)
    np.testing.assert_allclose(predicted, result.predictive.force, rtol=1e-6)
    np.testing.assert_array_equal(predicted["draw"], np.arange(0, 200, 10))
    np.testing.assert_array_equal(observed, record.force[::2])
    np.testing.assert_array_equal(observed["time"], record.time[::2])
    np.testing.assert_array_equal(observed["dof"], [1, 2])


def test_the_force_on_the_last_dof_is_its_own_column(tmp_path):
    record = make_record(dofs=3)
    samples = replace(make_samples(), force_dofs=np.array([3]))
    data = _written(make_result(samples, record), record, tmp_path / "posterior.nc")
    np.testing.assert_array_equal(data.observed_data["force"][:, 0], record.force[::2, 2])


def test_units_and_attributes(tmp_path):
    result = make_result(make_samples())
    record = make_record()
    labels = LABELS | {"snr_db": None}
    data = arviz.from_netcdf(
        write_posterior_data(
            posterior_groups(result, record, parameters_of(result.samples), labels), tmp_path / "posterior.nc"
        )
    )
    assert {name: data.posterior[name].attrs["units"] for name in ("c_1", "k_2", "kappa_2", "sigma_force")} == {
        "c_1": "N s/m", "k_2": "N/m", "kappa_2": "N/m^3", "sigma_force": "N",
    }  # fmt: skip
    assert data.posterior["k_2"].attrs["long_name"] == "stiffness of connection 2"
    assert data.posterior["kappa_2"].attrs["long_name"] == "Duffing coefficient of connection 2"
    assert data.attrs["method"] == "marginal"
    assert data.attrs["case"] == "pe"
    assert "snr_db" not in data.attrs
    assert data.attrs["inference_library"] == "pinn-cli"
    assert data.posterior.attrs["tuning_steps"] == 100
    assert data.posterior.attrs["sampling_time"] == 1.5


def test_without_steps_and_prediction_their_groups_are_missing(tmp_path):
    result = make_result(make_samples(statistics={}, method="laplace", chains=1))
    data = _written(result, make_record(), tmp_path / "posterior.nc")
    assert set(data.groups()) == {"posterior", "prior"}


def test_a_unit_that_is_unknown_is_left_out():
    result = make_result(make_samples(("k_1",)))
    groups = posterior_groups(result, make_record(), [Parameter("k", 0)], LABELS)
    assert "units" not in groups["posterior"]["k_1"].attrs


def test_a_predicted_force_of_another_shape_is_refused():
    with pytest.raises(ValueError, match=r"\(4, 20, 100, 1\); it must be \(chains, 20, 200, dofs\)"):
        ForcePredictive(np.arange(20), np.arange(200), np.zeros((4, 20, 100, 1)))


def test_arviz_is_not_imported():
    code = "import sys, pinn_cli.report.run_report; sys.exit('arviz' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
