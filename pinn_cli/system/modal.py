"""A structure of which some modes are known, and no more (``system=modal``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy.sparse import csr_matrix

from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import entries, is_finite_number, whole_number
from pinn_cli.system.connection.linear import Linear
from pinn_cli.system.connection_groups import ConnectionGroup
from pinn_cli.system.incidence import Incidence
from pinn_cli.system.labels import Labels
from pinn_cli.system.parameters import MASS
from pinn_cli.system.shapes import Shapes
from pinn_cli.system.structure import Structure
from pinn_cli.system.topology import checked_names

# More modes in one band are not told apart.
MOST_MODES = 40


@dataclass(frozen=True)
class ModesSought:
    """Which modes a record is asked for.

    Attributes:
        count: In the band; None: as many as the record shows.
        starts: Hz, where they are looked for; empty: wherever they are.
    """

    count: int | None = None
    starts: tuple[float, ...] = ()

    @classmethod
    def of(cls, modes: Any) -> ModesSought:
        """From ``system.modes``.

        Raises:
            InputError: It is no number of modes, and no list of frequencies.
        """
        if modes is None:
            return cls()
        if is_finite_number(modes):
            return cls(whole_number("system.modes", modes, least=1, most=MOST_MODES))
        given = entries(modes) if isinstance(modes, Sequence) and not isinstance(modes, str) else []
        if not given or len(given) > MOST_MODES or not all(is_finite_number(x) and x > 0 for x in given):
            allowed = "null (as many as the record shows), a number of modes, or a list of frequencies in Hz"
            raise InputError("system.modes", modes, allowed)
        return cls(len(given), tuple(sorted(float(x) for x in given)))


def build_modal(
    dofs: Sequence[str] | int | None = None, modes: Any = None, kind: str = "modal", measured: Sequence[str | int] = ()
) -> Structure:
    """A structure whose modes a record has yet to tell: one coordinate without a value.

    Args:
        dofs: Names of the measured points, or how many there are; None: those that a record's settings name.
        modes: See :class:`ModesSought`.
        kind: The name of the config group's choice.
        measured: DOFs with a force or a sensor, by name or by number from 1.

    Raises:
        InputError: Naming ``system.dofs`` or ``system.modes``.
    """
    ModesSought.of(modes)
    if dofs is None:
        names = tuple(dict.fromkeys(dof for dof in measured if isinstance(dof, str) and not dof.isdecimal()))
        count = max([len(names), *(int(dof) for dof in measured if str(dof).isdecimal())])
        if not count or (names and count > len(names)):
            raise InputError("system.dofs", None, "given: names of the measured points, such as [root, tip]")
    elif is_finite_number(dofs):
        names, count = (), whole_number("system.dofs", dofs, least=1)
    else:
        names = checked_names(entries(dofs))
        count = len(names)
    nothing = np.full(1, np.nan)
    return modal_structure(names, np.ones((count, 1)), (nothing, nothing, nothing), (0, 0))


def modal_structure(
    dofs: tuple[str, ...],
    shapes: np.ndarray,
    values: tuple[np.ndarray, np.ndarray, np.ndarray],
    outside: tuple[int, int],
) -> Structure:
    """A structure of modes, those of the band first, then those below it and those above.

    Args:
        dofs: Names; empty: they go by their numbers.
        shapes: (dofs, n), how far every DOF moves with every mode.
        values: Modal masses, kg, damping, N s/m, and stiffnesses, N/m, each (n,).
        outside: How many modes are below the band, and above.
    """
    n, (below, above) = shapes.shape[1], outside
    within = n - below - above
    names = [f"mode_{i + 1}" for i in range(within)]
    names += [f"below_{i + 1}" for i in range(below)] + [f"above_{i + 1}" for i in range(above)]
    m, c, k = (torch.tensor(np.asarray(x, dtype=float)) for x in values)
    return Structure(
        {MASS: m, "c": c, "k": k},
        (ConnectionGroup(Linear(), Incidence(csr_matrix(np.eye(n)))),),
        Labels(dofs, tuple(names), tuple(names)),
        mode_shapes=Shapes(shapes, None, csr_matrix((0, len(shapes))), above, below),
    )
