"""Where unknown parameters of structures that are no chains start, and which are unknown unless the user says so."""

from __future__ import annotations

import numpy as np
import pytest

from pinn_cli.record.excitation.banded_noise import BandedNoise
from pinn_cli.record.noise import Noise
from pinn_cli.record.record import Measurements
from pinn_cli.record.simulated import Simulated
from pinn_cli.record.simulation import Simulation
from pinn_cli.scheme.bayesian import Bayesian
from pinn_cli.scheme.missing_values import check_given
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.scheme.unknowns import parameters_called, unknown_parameters
from pinn_cli.settings.errors import InputError
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Polynomial
from pinn_cli.system.topology import build_partial_structure, build_structure

DOFS = ["x1", "x2", "x3"]
MASS = {"x1": 2000, "x2": 2000, "x3": 1500}
CONNECTIONS = {
    "storey_1": {"between": ["ground", "x1"], "law": "duffing", "c": 4500, "k": 1.5e6, "kappa": 1e9},
    "storey_2": {"between": ["x1", "x2"], "law": "linear", "c": 4200, "k": 1.4e6},
    "storey_3": {"between": ["x2", "x3"], "law": "linear", "c": 3600, "k": 1.2e6},
    "brace": {"between": ["ground", "x2"], "law": "polynomial", "c": 300, "k": 4e5, "k_3": 1e9},
    "damper": {"between": ["x1", "x3"], "law": "linear", "c": 3000, "k": 0},
    "slide": {"weights": {"x1": -0.8, "x3": 0.8}, "law": "friction", "speed": 0.02, "c": 0, "k": 0, "F_c": 50},
}
FRAME = build_structure(DOFS, MASS, CONNECTIONS)


@pytest.fixture(scope="module")
def measurements() -> Measurements:
    force = BandedNoise(3, 20.0, 2049, [0.5, 20.0], 2000.0, [3])
    return Simulated(force, Simulation(20.0, 2049), Noise(40.0, 0)).measure(FRAME)


def test_springs_and_dampers_start_near_the_truth(measurements):
    unknown = ["k_storey_*", "k_brace", "c_*", "kappa_*", "k_3_*", "F_c_*"]
    scheme = StateParameter(unobserved=[], unknown=unknown)
    problem = scheme.pose(FRAME, [scheme.observe(measurements.record)]).alone
    starts = {p.name: p for p in problem.uncertain if p.unknown}
    for name in ("storey_1", "storey_2", "storey_3", "brace"):
        assert starts[f"k_{name}"].prescribed == pytest.approx(CONNECTIONS[name]["k"], rel=0.3)
    for name in ("storey_1", "storey_2", "storey_3", "damper"):
        # One damping ratio for all: the order of magnitude.
        assert 0.1 < starts[f"c_{name}"].prescribed / CONNECTIONS[name]["c"] < 10.0
    assert (starts["kappa_storey_1"].prescribed, starts["k_3_brace"].prescribed) == (0.0, 0.0)
    # Wide enough for the truth, each on the scale of its own connection.
    for name, connection in (("kappa", "storey_1"), ("k_3", "brace"), ("F_c", "slide")):
        assert starts[f"{name}_{connection}"].prior_std > CONNECTIONS[connection][name]


def test_the_bayesian_scheme_takes_every_parameter_but_the_masses(measurements):
    scheme = Bayesian(
        priors={"k_3": {"kind": "normal", "mean": 0.0, "std": 1e9}, "k_brace": {"kind": "half_normal", "scale": 1e6}}
    )
    problem = scheme.pose(FRAME, [scheme.observe(measurements.record)]).alone
    assert [p.name for p in problem.uncertain] == [p.name for p in FRAME.every_parameter() if p.kind != "m"]
    priors = {p.name: p.prior for p in problem.uncertain}
    assert (priors["k_3_brace"].name, priors["k_brace"].scale) == ("normal", 1e6)
    assert priors["k_storey_1"].scale != 1e6


def test_unknown_by_default_are_springs_that_end_where_there_is_no_sensor(measurements):
    record = measurements.record.keep({"acceleration": [1, 3]})
    names = [p.name for p in unknown_parameters(FRAME, record, None)]
    assert names == ["k_storey_2", "k_storey_3", "k_brace", "k_3_brace"]
    record = measurements.record.keep({"acceleration": [2, 3]})
    names = [p.name for p in unknown_parameters(FRAME, record, None)]
    assert names == ["k_storey_1", "k_storey_2", "k_damper", "k_slide", "kappa_storey_1", "F_c_slide"]


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("k_brace", ["k_brace"]),
        ("k_storey_*", ["k_storey_1", "k_storey_2", "k_storey_3"]),
        ("k_3_*", ["k_3_brace"]),
        ("*_brace", ["c_brace", "k_brace", "k_3_brace"]),
        ("k_*", [f"k_{name}" for name in ("storey_1", "storey_2", "storey_3", "damper", "brace", "slide")]),
        ("m_x[12]", ["m_x1", "m_x2"]),
    ],
)
def test_patterns_mean_kinds_and_names(measurements, pattern, names):
    found = [p.name for p in unknown_parameters(FRAME, measurements.record, pattern)]
    assert sorted(found) == sorted(names)
    assert sorted(p.name for p in parameters_called(pattern, FRAME, "scheme.initial")) == sorted(names)


def test_a_kind_means_its_parameters_and_no_others():
    assert [p.name for p in parameters_called("k_3", FRAME, "scheme.initial")] == ["k_3_brace"]
    assert {p.kind for p in parameters_called("k", FRAME, "scheme.initial")} == {"k"}
    # Of a numbered chain k_2 is what it always was, the second spring.
    chain = build_chain(2, Polynomial(), m=1.0, c=1.0, k=1.0, k_2=3.0)
    assert [p.name for p in parameters_called("k_2", chain, "scheme.initial")] == ["k_2"]
    assert [p.name for p in parameters_called("k_2_*", chain, "scheme.initial")] == ["k_2_1", "k_2_2"]


def test_an_unknown_name_is_answered_with_those_that_there_are(measurements):
    with pytest.raises(InputError) as error:
        unknown_parameters(FRAME, measurements.record, "k_brase")
    assert "one of m_x1, m_x2, m_x3, c_storey_1" in str(error.value)
    assert "did you mean k_brace?" in str(error.value)


def test_what_is_missing_is_told_as_it_would_be_given():
    connections = {
        "storey": {"between": ["ground", "x1"], "law": "linear", "c": 1.0, "k": None},
        "tie": {"between": ["x1", "x2"], "law": "linear", "c": None, "k": 3.0},
    }
    structure = build_partial_structure(["x1", "x2"], {"x1": 1.0, "x2": None}, connections)
    with pytest.raises(InputError) as error:
        check_given(structure)
    text = str(error.value)
    assert error.value.setting == "system.mass.x2, system.connections.tie.c, system.connections.storey.k"
    assert "m_x2, c_tie, k_storey" in text
    assert np.all(["kg" in text, "N s/m" in text, "N/m" in text])
    everything = list(structure.every_parameter())
    check_given(structure, everything)
