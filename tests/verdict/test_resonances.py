"""Resonances that the sensors show by themselves, against the natural frequencies of the estimated structure."""

from __future__ import annotations

import pytest
from ambient_records import AmbientRecord, ambient_record

from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.training.estimate import Estimate
from pinn_cli.verdict.input_findings import input_findings


@pytest.fixture(scope="module", params=[(4.0, None, 0), (1.5, 1.0, 2)], ids=["flat", "wind"])
def made(request) -> AmbientRecord:
    first_frequency, corner, seed = request.param
    return ambient_record(first_frequency, 50.0, 60.0, 20.0, corner, floors=4, seed=seed)


@pytest.mark.parametrize(("stiffer", "told"), [(1.0, ""), (0.6, "failed"), (1e-5, "failed")])
def test_a_structure_has_the_resonances_that_the_sensors_show(made, stiffer, told):
    problem = SparseRecovery().pose(made.structure, [made.record]).alone
    structure = made.structure.with_parameters(k=stiffer * made.structure.parameters["k"])
    estimate = Estimate(made.truth, made.truth, [], None, {})
    found = [f for f in input_findings(problem, estimate, structure) if f.kind == "resonances"]
    assert [f.word for f in found] == [told] * bool(told)
