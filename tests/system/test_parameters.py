"""What a parameter knows of itself, its name, and all of them as a vector."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from matplotlib.mathtext import MathTextParser
from structures import braced, shuffled

from pinn_cli.system.parameters import Labels, Parameter, ParameterVector, upright

DOFS = ("ground_floor", "mezzanine", "roof")
CONNECTIONS = ("storey_1", "storey_2", "storey_3", "brace", "tie", "damper")


@pytest.mark.parametrize("prescribed", [0.1, 0.3, 7.3, 123.4])
@pytest.mark.parametrize("prior_std", [0.7, 1e3])
def test_a_value_is_never_below_its_bound(prescribed, prior_std):
    free, bounded = (Parameter("k", 1, prescribed, prior_std, positive=positive) for positive in (False, True))
    assert (free.lower, bounded.lower) == (-math.inf, -prescribed)
    assert bounded.value(bounded.lower) == 0.0
    assert bounded.value(prior_std * (bounded.lower / prior_std) * (1 + 1e-15)) >= 0.0
    assert bounded.value(-0.5 * prescribed) == 0.5 * prescribed
    assert free.value(-2.0 * prescribed) == -prescribed


def test_a_parameter_is_the_same_whatever_is_believed_of_it():
    believed, bare = Parameter("kappa", 3, 100.0, 7.5, unit="N/m^3"), Parameter("kappa", 3)
    assert believed == bare
    assert {believed: 1}[bare] == 1
    assert believed != Parameter("kappa", 2)
    assert (bare.name, bare.owner, bare.symbol) == ("kappa_4", "connection 4", r"$\kappa_{4}$")
    assert (Parameter("m", 0).owner, Parameter("k", 0, label="brace").name) == ("DOF 1", "k_brace")


@pytest.mark.parametrize("name", ["$", "a$b", "$\\frac$", "#^", "{", "a\\", '"`', "%&_", "\x1b[2J", "a{b}c~'"])
def test_any_name_can_be_set_as_mathematics(name):
    parser = MathTextParser("path")
    parser.parse(Parameter("gain", 0, label=name).symbol)
    assert parser.parse(rf"${upright(f'{name}m')}$").width > parser.parse(rf"${upright('m')}$").width


def test_parameters_go_by_the_names_of_their_masses_and_connections():
    structure = replace(braced(), labels=Labels(DOFS, CONNECTIONS))
    names = [parameter.name for parameter in structure.every_parameter()]
    assert names[:3] == ["m_ground_floor", "m_mezzanine", "m_roof"]
    # A kind that few connections have is named after those, not after the first ones of the structure.
    assert (names[-1], structure.parameter("kappa", 2).name) == ("mu_damper", "kappa_storey_3")
    assert (structure.parameter("k", 3).owner, structure.parameter("m", 2).owner) == ("connection brace", "DOF roof")
    assert [structure.dof_name(i) for i in range(3)] == list(DOFS)
    # Names outlive a change of values and of laws; without names parameters are numbered from one.
    assert structure.with_values({structure.parameter("k", 3): 7.0}).parameter("k", 3).name == "k_brace"
    assert structure.linearised().parameter("k", 5).name == "k_damper"
    assert (shuffled().parameter("k", 1).name, shuffled().dof_name(0)) == ("k_2", "1")


@pytest.mark.parametrize("as_is", [torch.as_tensor, np.asarray], ids=["tensors", "arrays"])
def test_a_vector_of_parameters_by_name(as_is):
    structure = braced()
    moving = [Parameter("mu", 0), Parameter("k", 4), Parameter("m", 1)]
    nominal = {kind: as_is(values.numpy()) for kind, values in structure.parameters.items()}
    vector = ParameterVector(nominal, moving)
    assert (vector.kinds, vector.places) == (("m", "k", "mu"), 3 + 6 + 1)
    values = vector.values(as_is(np.array([0.1, 2.0, -1.0])))
    expected = {kind: given.numpy().copy() for kind, given in structure.parameters.items()}
    expected["mu"][0] += 0.1
    expected["k"][4] += 2.0
    expected["m"][1] -= 1.0
    for kind, given in expected.items():
        np.testing.assert_array_equal(values[kind], given)
