"""Unknowns whose true value is zero, beside what the record determines well, through the whole program."""

import numpy as np
import pytest
from storeys import K, record, system, written


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_offset_and_quadratic_springs_of_zero_leave_a_good_run_sound(pinn_run, tmp_path, seed):
    written(record(seed, duration=20.0, snr_db=40.0).record, tmp_path / "rig.csv")
    channels = ", ".join(f"a{i}: {{sensor: acceleration, dof: {i}, offset: unknown}}" for i in (1, 2, 3))
    done = pinn_run(
        "system=polynomial", *system()[1:], "system.nonlinearity.orders=[2]", "data=csv",
        f"data.path={tmp_path}/rig.csv",
        f"data.channels={{f: {{sensor: force, dof: 3}}, {channels}}}", "data.time=t", "scheme=state_parameter",
        "scheme.unknown=[k_*,k_2_*]", "figures=false", "threads=1",
    ).done()  # fmt: skip
    found = done.parameters
    zero = found[found.index.str.startswith(("offset", "k_2_"))]
    zero = zero[zero["start"].notna() & ~zero.index.isin(["k_1", "k_2", "k_3"])]
    assert len(zero) == 6
    assert np.all(np.abs(zero["estimate"]) < 4.0 * zero["std"])
    np.testing.assert_allclose(found.loc[["k_1", "k_2", "k_3"], "estimate"], K, rtol=2e-3)
    assert done.record["verdict"] == "sound"
