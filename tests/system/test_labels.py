"""Names of coordinates and connections in the names of parameters."""

from dataclasses import replace

from structures import braced, shuffled

from pinn_cli.system.labels import Labels

DOFS = ("ground_floor", "mezzanine", "roof")
CONNECTIONS = ("storey_1", "storey_2", "storey_3", "brace", "tie", "damper")


def test_parameters_go_by_the_names_of_their_masses_and_connections():
    structure = replace(braced(), labels=Labels(DOFS, CONNECTIONS))
    names = [parameter.name for parameter in structure.every_parameter()]
    assert names[:3] == ["m_ground_floor", "m_mezzanine", "m_roof"]
    # A kind that few connections have is named after those, not after the first ones of the structure.
    assert names[-1] == "mu_damper"
    assert structure.parameter("kappa", 2).name == "kappa_storey_3"
    assert structure.parameter("k", 3).owner == "connection brace"
    assert structure.parameter("m", 2).owner == "DOF roof"
    assert [structure.dof_name(i) for i in range(3)] == list(DOFS)


def test_a_structure_without_names_is_numbered_from_one():
    structure = shuffled()
    assert structure.parameter("k", 1).name == "k_2"
    assert structure.dof_name(0) == "1"


def test_names_outlive_a_change_of_values_and_of_laws():
    structure = replace(braced(), labels=Labels(DOFS, CONNECTIONS))
    moved = structure.with_values({structure.parameter("k", 3): 7.0})
    assert moved.parameter("k", 3).name == "k_brace"
    assert structure.linearised().parameter("k", 5).name == "k_damper"
