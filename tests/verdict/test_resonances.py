"""Resonances that the sensors show by themselves, against the natural frequencies of the estimated structure."""

import pytest
from ambient_records import AmbientRecord, ambient_record
from storeys import K, M, record

from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.system.structure import Structure
from pinn_cli.verdict.input_findings import resonance_findings


@pytest.fixture(scope="module", params=[(4.0, None, 0), (1.5, 1.0, 2)], ids=["flat", "wind"])
def made(request) -> AmbientRecord:
    first_frequency, corner, seed = request.param
    return ambient_record(first_frequency, 50.0, 60.0, 20.0, corner, floors=4, seed=seed)


def words(structure: Structure, record) -> list[str]:
    problem = SparseRecovery().pose(structure, [record]).alone
    return [finding.word for finding in resonance_findings(problem, structure)]


@pytest.mark.parametrize(("stiffer", "told"), [(1.0, ""), (0.6, "failed"), (1e-5, "failed")])
def test_a_structure_in_the_wind_has_the_resonances_that_the_sensors_show(made, stiffer, told):
    structure = made.structure.with_parameters(k=stiffer * made.structure.parameters["k"])
    assert words(structure, made.record) == [told] * bool(told)


@pytest.mark.parametrize(("stiffer", "told"), [(1.0, ""), (0.6, "questionable"), (1e-5, "failed")])
def test_and_one_under_a_measured_force_those_of_the_response_to_it(stiffer, told):
    structure = build_chain(len(K), Linear(), m=M, c=0.002 * K, k=stiffer * K)
    assert words(structure, record(0).record) == [told] * bool(told)
