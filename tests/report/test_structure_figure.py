"""The drawing of a structure that a user wrote down."""

import numpy as np
import pytest

from pinn_cli.report.figures.structure import layout, structure_figure
from pinn_cli.system.structure import Structure
from pinn_cli.system.topology import build_structure

LINE = {"law": "linear", "c": 1.0, "k": 5.0}
STOREYS = {
    "storey_1": {"between": ["ground", "x1"], **LINE},
    "storey_2": {"between": ["x1", "x2"], **LINE},
    "storey_3": {"between": ["x2", "x3"], **LINE},
}


def frame(**more) -> Structure:
    return build_structure(["x1", "x2", "x3"], {"x1": 2000, "x2": 2000, "x3": 1500}, {**STOREYS, **more})


def truss(floors: int = 5) -> Structure:
    """Two columns in the plane, with beams and diagonals; every node moves across and up."""
    nodes = {(i, j): (f"x{i}{'lr'[j]}", f"y{i}{'lr'[j]}") for i in range(1, floors + 1) for j in (0, 1)}
    bars = {}
    for i in range(floors):
        bars |= {f"column_{i + 1}{'lr'[j]}": ((i, j), (i + 1, j)) for j in (0, 1)}
        bars |= {f"beam_{i + 1}": ((i + 1, 0), (i + 1, 1)), f"diagonal_{i + 1}": ((i, 0), (i + 1, 1))}
    connections = {}
    for name, (a, b) in bars.items():
        along = np.array([b[1] - a[1], b[0] - a[0]]) / np.hypot(b[1] - a[1], b[0] - a[0])
        weights = {
            dof: float(sign * part)
            for node, sign in ((a, -1), (b, 1))
            if node in nodes
            for dof, part in zip(nodes[node], along, strict=True)
            if part
        }
        connections[name] = {"weights": weights, "law": "linear", "c": 1e3, "k": 1e7}
    return build_structure([dof for pair in nodes.values() for dof in pair], 500.0, connections)


def test_storeys_stand_above_each_other_whatever_braces_there_are():
    brace, tie = {"between": ["ground", "x2"], **LINE}, {"between": ["x3", "x1"], **LINE}
    for structure in (frame(), frame(brace=brace, tie=tie)):
        places, _ = layout(structure.incidence.matrix)
        np.testing.assert_array_equal(places, [[0.0, 1.0], [0.0, 2.0], [0.0, 3.0]])


@pytest.mark.parametrize("structure", [frame(), truss()], ids=["frame", "truss"])
def test_masses_do_not_stand_in_each_other_s_place(structure):
    places, _ = layout(structure.incidence.matrix)
    apart = np.abs(places[:, None] - places[None]).max(axis=-1)
    assert apart[~np.eye(len(places), dtype=bool)].min() >= 0.5


def drawn(structure: Structure) -> list[str]:
    return [text.get_text() for text in structure_figure(structure).axes[0].texts]


def test_every_mass_and_every_connection_is_named():
    lever = {"weights": {"x1": 0.8, "x3": -0.6}, "law": "friction", "speed": 0.01, "c": 0, "k": 0, "F_c": 100}
    structure = frame(brace={"between": ["ground", "x2"], **LINE}, lever=lever, twin=STOREYS["storey_1"])
    texts = drawn(structure)
    assert {"x1\n2000 kg", "x2\n2000 kg", "x3\n1500 kg", "0.8", "-0.6", *structure.labels.connections} == set(texts)
    legend = [text.get_text() for text in structure_figure(structure).legends[0].texts]
    assert legend == ["linear", "friction"]
    assert set(truss().labels.connections) <= set(drawn(truss()))


def test_names_of_connections_do_not_meet():
    structure = frame(
        brace={"between": ["ground", "x2"], **LINE}, twin=STOREYS["storey_2"], tie={"between": ["x1", "x3"], **LINE}
    )
    texts = structure_figure(structure).axes[0].texts
    places = np.array([t.get_position() for t in texts if t.get_text() in structure.labels.connections])
    apart = np.abs(places[:, None] - places[None]) / [0.4, 0.15]
    assert apart.max(axis=-1)[~np.eye(len(places), dtype=bool)].min() >= 1.0
