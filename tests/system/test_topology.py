"""Structures from named coordinates and connections, and chains."""

import copy
import logging
import math
from importlib.metadata import EntryPoint

import numpy as np
import pytest
import torch
from calls import refusal

from pinn_cli.settings import instantiation
from pinn_cli.settings.errors import InputError
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing, Linear, PowerDamping, VanDerPol
from pinn_cli.system.coupling import loose_dofs
from pinn_cli.system.topology import build_structure, whole

FRAME = {
    "dofs": ["x1", "x2", "x3"],
    "mass": {"x1": 2000, "x2": 2000, "x3": 1500},
    "connections": {
        "storey_1": {"between": ["ground", "x1"], "law": "duffing", "c": 4500, "k": 1.5e6, "kappa": 1e10},
        "storey_2": {"between": ["x1", "x2"], "law": "linear", "c": 4200, "k": 1.4e6},
        "storey_3": {"between": ["x2", "x3"], "law": "linear", "c": 3600, "k": 1.2e6},
        "lever": {"weights": {"x1": 0.8, "x3": -0.6}, "law": "polynomial", "c": 0, "k": 1e5, "k_3": 2e8},
        "joint": {"between": ["x3", "x1"], "law": "friction", "speed": 0.01, "c": 0, "k": 0, "F_c": 300},
        "sleeve": {"between": ["x2", "ground"], "law": "friction", "speed": 0.02, "c": 0, "k": 0, "F_c": 100},
        "storey_1b": {"between": ["ground", "x1"], "law": "duffing", "c": 10, "k": 1e3, "kappa": -1e6},
    },
}


def frame(**connections):
    changed = copy.deepcopy(FRAME)
    changed["connections"] |= connections
    return changed


def test_coordinates_laws_and_parameters_are_those_written():
    structure = build_structure(**FRAME)
    # A law with other settings, or with other orders, is a law of its own.
    names = [(group.nonlinearity.name, group.incidence.shape[0]) for group in structure.groups]
    assert names == [("duffing", 2), ("linear", 2), ("polynomial", 1), ("friction", 1), ("friction", 1)]
    written = {"mass": FRAME["mass"], "connections": FRAME["connections"]}
    for parameter in structure.every_parameter():
        if parameter.kind == "m":
            assert parameter.prescribed == written["mass"][parameter.label]
        else:
            assert parameter.prescribed == written["connections"][parameter.label][parameter.kind]
    own = {"storey_1": 3, "storey_2": 2, "storey_3": 2, "lever": 3, "joint": 3, "sleeve": 3, "storey_1b": 3}
    assert len(list(structure.every_parameter())) == 3 + sum(own.values())


def test_forces_are_those_of_the_equations_written_out():
    structure = build_structure(**FRAME)
    x1, x2, x3 = u = np.array([0.003, -0.002, 0.005])
    v1, v2, v3 = v = np.array([0.05, 0.02, -0.03])
    storey_1 = 4500 * v1 + 1.5e6 * x1 + 1e10 * x1**3 + 10 * v1 + 1e3 * x1 - 1e6 * x1**3
    storey_2 = 4200 * (v2 - v1) + 1.4e6 * (x2 - x1)
    storey_3 = 3600 * (v3 - v2) + 1.2e6 * (x3 - x2)
    e = 0.8 * x1 - 0.6 * x3
    lever = 1e5 * e + 2e8 * e**3
    joint = 300 * math.tanh((v1 - v3) / 0.01)
    sleeve = 100 * math.tanh(-v2 / 0.02)
    expected = [storey_1 - storey_2 + 0.8 * lever + joint, storey_2 - storey_3 - sleeve, storey_3 - 0.6 * lever - joint]
    np.testing.assert_allclose(structure.restoring_force(u, v), expected, rtol=1e-12)
    in_torch = structure.restoring_force(torch.tensor(u), torch.tensor(v))
    np.testing.assert_allclose(in_torch.numpy(), expected, rtol=1e-12)


def test_a_chain_written_out_is_the_chain():
    k = [15.0, 14.0, 13.0]
    chain = build_chain(3, Duffing(), m=10.0, c=1.0, k=k, kappa=100.0)
    ends = [("ground", "a"), ("a", "b"), ("b", "c")]
    written = build_structure(
        ["a", "b", "c"],
        10.0,
        {
            f"spring_{i}": {"between": list(pair), "law": "duffing", "c": 1.0, "k": stiffness, "kappa": 100.0}
            for i, (pair, stiffness) in enumerate(zip(ends, k, strict=True))
        },
    )
    assert list(written.parameters) == list(chain.parameters)
    assert all(torch.equal(written.parameters[kind], chain.parameters[kind]) for kind in chain.parameters)
    assert (written.incidence.matrix != chain.incidence.matrix).nnz == 0


def test_of_a_measured_structure_values_may_be_missing():
    connections = {
        "a": {"between": ["ground", "x1"], "law": "linear", "c": None},
        "b": {"between": ["x1", "x2"], "law": "polynomial", "c": 1.0, "k": 2.0, "k_2": None, "k_5": 3.0},
    }
    structure = build_structure(["x1", "x2"], {"x1": None, "x2": 3.0}, connections)
    values = {parameter.name: parameter.prescribed for parameter in structure.every_parameter()}
    unknown = {name for name, value in values.items() if math.isnan(value)}
    assert unknown == {"m_x1", "c_a", "k_a", "k_2_b"}
    assert values["k_5_b"] == 3.0
    assert not {"k_3_b", "k_4_b"} & values.keys()


def test_units_are_those_of_each_connection_s_own_law():
    drag = {"between": ["x1", "x2"], "law": "power_damping", "exponent": 1.5, "c": 0, "k": 0, "mu": 1.0}
    lively = {"between": ["x1", "x3"], "law": "van_der_pol", "c": 0, "k": 0, "mu": 1.0}
    units = {p.name: p.unit for p in build_structure(**frame(drag=drag, lively=lively)).every_parameter()}
    assert (units["mu_drag"], units["mu_lively"]) == ("N (s/m)^1.5", "N s/m")
    assert (units["k_3_lever"], units["F_c_joint"], units["m_x1"]) == ("N/m^3", "N", "kg")


LINE = {"between": ["ground", "x1"], "law": "linear", "c": 0, "k": 1.0}


@pytest.mark.parametrize(
    ("setting", "names", "changes"),
    [
        ("system.dofs", "a list of names", {"dofs": "x1"}),
        ("system.dofs", "a letter first", {"dofs": ["x1", "2nd", "x3"]}),
        ("system.dofs", "in quotes", {"dofs": [True, "x2"]}),
        ("system.dofs", "the support", {"dofs": ["x1", "ground"]}),
        ("system.dofs", "once only", {"dofs": ["x1", "x2", "x1"]}),
        ("system.mass.x3", "no equation of motion", {"mass": {"x1": 1.0, "x2": 1.0}}),
        ("system.mass", "one of x1, x2, x3; did you mean x3", {"mass": {"x1": 1, "x2": 1, "x3": 1, "x33": 1}}),
        ("system.mass.x2", "> 0", {"mass": {"x1": 1.0, "x2": 0.0, "x3": 1.0}}),
        ("system.mass.x2", "given", {"mass": {"x1": 1.0, "x2": None, "x3": 1.0}}),
        ("system.mass", "a map", {"mass": "heavy"}),
        ("system.mass.x1", "a number", {"mass": {"x1": "1 t", "x2": 1.0, "x3": 1.0}}),
        ("system.connections", "a map of name", {"connections": {}}),
        ("system.connections", "a letter first", {"connections": {"2": LINE}}),
        ("system.connections.a", "a map such as", {"connections": {"a": 5.0}}),
    ],
)
def test_unusable_structures_are_refused_in_one_line(setting, names, changes):
    told = refusal(lambda: whole(build_structure(**{**FRAME, **changes})))
    assert told.startswith(f"{setting}=")
    assert names in told


@pytest.mark.parametrize(
    ("setting", "names", "entry"),
    [
        ("", "either between", {"law": "linear", "c": 0, "k": 1}),
        ("", "either between", {**LINE, "weights": {"x1": 1.0}}),
        (".between", "two ends", {**LINE, "between": ["x1"]}),
        (".between", "ground or one of x1, x2, x3; did you mean x2", {**LINE, "between": ["ground", "x22"]}),
        (".between", "two different ends", {**LINE, "between": ["x1", "x1"]}),
        (".weights", "one is not 0", {"weights": {"x1": 0, "x2": 0.0}, "law": "linear", "c": 0, "k": 1}),
        (".weights", "does not move", {"weights": {"ground": 1.0}, "law": "linear", "c": 0, "k": 1}),
        (".weights", "one of x1, x2, x3", {"weights": {"roof": 1.0}, "law": "linear", "c": 0, "k": 1}),
        (".weights", "a map of coordinate", {"weights": {"x1": "half"}, "law": "linear", "c": 0, "k": 1}),
        (".law", "given", {"between": ["ground", "x1"], "c": 0, "k": 1}),
        (".law", "did you mean duffing", {**LINE, "law": "dufing"}),
        (".kappa", "left out: a linear connection has c, k", {**LINE, "kappa": 3.0}),
        (".k", "given; 0 is a value", {"between": ["ground", "x1"], "law": "linear", "c": 0}),
        (".k", ">= 0", {**LINE, "k": -1.0}),
        (".k", "a number", {**LINE, "k": "stiff"}),
        (".F_c", ">= 0", {**LINE, "law": "friction", "speed": 0.1, "F_c": -1.0}),
        (".speed", "> 0", {**LINE, "law": "friction", "F_c": 1.0, "speed": 0}),
        (".exponent", ">= 1", {**LINE, "law": "power_damping", "mu": 1.0, "exponent": 0.5}),
        (".k_3", "given", {**LINE, "law": "polynomial"}),
        (".k_8", "left out", {**LINE, "law": "polynomial", "k_2": 1.0, "k_8": 1.0}),
    ],
)
def test_unusable_connections_are_refused_in_one_line(setting, names, entry):
    told = refusal(lambda: whole(build_structure(**frame(one=entry))))
    assert told.startswith(f"system.connections.one{setting}=")
    assert names in told


class Rubber(Linear):
    """Somebody else's law, whose parameter begins like another one's name."""

    name = "rubber"
    parameters = ("k_a",)


def test_laws_of_installed_packages_are_found_by_their_entry_points(monkeypatch):
    point = EntryPoint("system.rubber", f"{__name__}:Rubber", instantiation.PLUGINS)
    monkeypatch.setattr(instantiation, "entry_points", lambda group: [point] if group == instantiation.PLUGINS else [])
    rubber = {"between": ["x1", "x2"], "law": "rubber", "c": 0, "k": 0, "k_a": 1.0}
    structure = build_structure(**frame(pad=rubber))
    assert structure.groups[-1].nonlinearity.name == "rubber"
    with pytest.raises(InputError, match=r"friction, .*rubber; did you mean rubber"):
        build_structure(**frame(pad={**rubber, "law": "ruber"}))
    # k of a connection called a_pad reads like k_a of one called pad.
    with pytest.raises(InputError, match="would both be called k_a_pad"):
        build_structure(**frame(pad=rubber, a_pad=LINE))


def test_a_structure_that_is_not_held_is_told(caplog):
    line = {"law": "linear", "c": 1.0, "k": 5.0}
    free = {"a": {"between": ["x1", "x2"], **line}, "b": {"between": ["ground", "x3"], **line}}
    with caplog.at_level(logging.WARNING):
        build_structure(["x1", "x2", "x3"], 1.0, free)
    assert [r.getMessage() for r in caplog.records] == [
        "the structure is not held: x1, x2 can move without stretching any spring (a rigid body's motion)"
    ]


@pytest.mark.parametrize("loose", [{"k": 0.0, "law": "linear"}, {"k": 0.0, "law": "friction", "speed": 1, "F_c": 1.0}])
def test_a_damper_or_a_sliding_joint_does_not_hold(loose, caplog):
    build_structure(["x1"], 1.0, {"a": {"between": ["ground", "x1"], "c": 1.0, **loose}})
    assert "not held" in caplog.text


def test_springs_of_any_kind_hold(caplog):
    cubic = {"between": ["ground", "x1"], "law": "duffing", "c": 1.0, "k": 0.0, "kappa": 3.0}
    build_structure(["x1"], 1.0, {"a": cubic})
    build_structure(**FRAME)
    loops = {"law": "bouc_wen", "c": 0, "k": 0, "A": 4e5, "beta": 30, "gamma": 20, "n": 1}
    build_structure(["x1"], 1.0, {"a": {"between": ["ground", "x1"], **loops}})
    build_structure(["x1"], 1.0, {"a": {"between": ["ground", "x1"], "law": "linear"}})
    assert not caplog.text
    assert loose_dofs(build_chain(2000, Linear(), m=1.0, c=0.0, k=1.0)) == []


LEGAL = {"m": 10.0, "c": 1.0, "k": 15.0, "kappa": 100.0}


def test_numbers_and_lists_become_float64_of_every_connection():
    structure = build_chain(3, Duffing(), **{**LEGAL, "k": [15, 14, 16.5], "m": 10})
    assert structure.ndof == 3
    assert {value.dtype for value in structure.parameters.values()} == {torch.float64}
    assert structure.parameters["k"].tolist() == [15.0, 14.0, 16.5]
    assert structure.parameters["m"].tolist() == [10.0] * 3


def test_what_is_missing_is_named():
    with pytest.raises(InputError, match=r"^system\.mu=nothing"):
        build_chain(3, VanDerPol(), m=1.0, c=1.0, k=1.0)
    with pytest.raises(InputError, match=r"list of 3 numbers \(system\.ndof=3\); it has 2"):
        build_chain(3, Linear(), m=1.0, c=1.0, k=[1.0, 2.0])


def test_signs_that_make_sense_pass():
    assert build_chain(2, Duffing(), **{**LEGAL, "kappa": -5.0}).parameters["kappa"].tolist() == [-5.0, -5.0]
    assert build_chain(2, VanDerPol(), m=1.0, c=0.0, k=0.0, mu=-0.1).parameters["mu"].tolist() == [-0.1, -0.1]
    with pytest.raises(InputError, match=r"^system\.mu="):
        build_chain(2, PowerDamping(), m=1.0, c=0.0, k=0.0, mu=-0.1)
