"""Structures that are no chains: braces, several laws, weighted connections, coordinates in any order."""

from dataclasses import replace

import numpy as np
import torch
from scipy.sparse import csr_matrix

from pinn_cli.system.connection import BoucWen, Duffing, Linear, VanDerPol
from pinn_cli.system.connection_groups import ConnectionGroup
from pinn_cli.system.incidence import Incidence
from pinn_cli.system.parameters import Labels
from pinn_cli.system.shapes import Shapes
from pinn_cli.system.structure import Structure


def _numbers(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


def braced() -> Structure:
    """Three storeys with cubic springs, a brace from the ground to the second and one from first to third, and a damper
    that feels eight tenths of one displacement and six of another."""
    storeys = Incidence.between([{0: 1.0}, {0: -1.0, 1: 1.0}, {1: -1.0, 2: 1.0}], 3)
    braces = Incidence.between([{1: 1.0}, {0: -1.0, 2: 1.0}], 3)
    damper = Incidence.between([{0: 0.8, 2: -0.6}], 3)
    parameters = {
        "m": _numbers(10.0, 9.0, 8.0),
        "c": _numbers(1.0, 1.1, 1.2, 0.4, 0.5, 0.3),
        "k": _numbers(15.0, 14.0, 13.0, 6.0, 5.0, 2.0),
        "kappa": _numbers(100.0, 90.0, 80.0),
        "mu": _numbers(0.7),
    }
    groups = (
        ConnectionGroup(Duffing(), storeys),
        ConnectionGroup(Linear(), braces),
        ConnectionGroup(VanDerPol(), damper),
    )
    return Structure(parameters, groups)


def shuffled(ndof: int = 6) -> Structure:
    """A chain whose coordinates are numbered first the odd ones, then the even ones."""
    number = {place: i for i, place in enumerate([*range(0, ndof, 2), *range(1, ndof, 2)])}
    ends = [{number[0]: 1.0}, *({number[i - 1]: -1.0, number[i]: 1.0} for i in range(1, ndof))]
    values = torch.arange(1, ndof + 1, dtype=torch.float64)
    parameters = {"m": 10.0 + values, "c": 1.0 + 0.1 * values, "k": 15.0 + values, "kappa": 100.0 + values}
    return Structure(parameters, (ConnectionGroup(Duffing(), Incidence.between(ends, ndof)),))


def hysteretic() -> Structure:
    """A braced frame of two masses whose brace has memory, as has the connection between them; one spring is cubic."""
    groups = (
        ConnectionGroup(Duffing(), Incidence.between([{0: 1.0}], 2)),
        ConnectionGroup(BoucWen(), Incidence.between([{0: -1.0, 1: 1.0}, {1: 1.0}], 2)),
    )
    parameters = {
        "m": _numbers(10.0, 8.0),
        "c": _numbers(1.0, 1.2, 0.7),
        "k": _numbers(15.0, 6.0, 4.0),
        "kappa": _numbers(30.0),
        "A": _numbers(9.0, 7.0),
        "beta": _numbers(2.0, 1.4),
        "gamma": _numbers(-0.6, 0.5),
        "n": _numbers(1.0, 1.3),
    }
    return Structure(parameters, groups)


def carried() -> Structure:
    """The hysteretic frame whose cubic spring and whose brace stand on two supports that move."""
    return replace(hysteretic(), by_supports=csr_matrix([[-1.0, 0.0], [0.0, 0.0], [0.3, -1.0]]))


def modal() -> Structure:
    """Three modes of a structure of four DOFs, with a cubic spring between two of them and a damper to the ground."""
    shapes = np.array([[0.3, 0.5, -0.2], [0.6, 0.1, 0.4], [0.8, -0.7, 0.1], [0.2, 0.3, 0.9]])
    groups = (
        ConnectionGroup(Linear(), Incidence(csr_matrix(np.eye(3)))),
        ConnectionGroup(Duffing(), Incidence(csr_matrix([shapes[2] - shapes[0]]))),
        ConnectionGroup(Linear(), Incidence(csr_matrix([shapes[3]]))),
    )
    parameters = {
        "m": _numbers(1.0, 1.0, 1.0),
        "c": _numbers(0.1, 0.2, 0.3, 0.1, 0.4),
        "k": _numbers(2.0, 9.0, 20.0, 0.5, 0.0),
        "kappa": _numbers(30.0),
    }
    carried = np.array([1.0, 0.0, 1.0, 1.0])
    return Structure(
        parameters, groups, Labels(("a", "b", "c", "d")), np.array([0.9, -0.3, 0.5]), Shapes(shapes, carried)
    )
