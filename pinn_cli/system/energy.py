"""Energy that connections take out of a motion."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch

from pinn_cli.system.array_namespace import Array
from pinn_cli.system.connection.nonlinearity import Hysteresis
from pinn_cli.system.structure import Structure


def dissipated_power(
    structure: Structure, e: Array, de: Array, parameters: Mapping[str, Array], z: Array | None = None
) -> Array:
    """(..., C), W: what of the internal force is not there when the connection stands still, times its rate.

    So a spring has none, whatever its law, and a damper c de^2. A hidden force counts as a whole: what it stores and
    gives back is :func:`stored_by_memory`. Negative where a connection puts energy in, as a Van der Pol one may.
    Elongations e (..., C) are in m, their rates in m/s; z are hidden forces (..., h), None where nothing has memory.
    """
    force = structure.connection_force(e, de, parameters, z)
    still = structure.connection_force(e, 0.0 * de, parameters, None if z is None else 0.0 * z)
    return (force - still) * de


def stored_by_memory(structure: Structure, z: Array, parameters: Mapping[str, Array]) -> Array:
    """(..., h), J: z^2 / (2 dz/de) at rest, what a connection with memory gives back when its hidden force goes to 0.

    Exactly so for a connection that unloads with the stiffness that it has at rest.
    """
    stored = 0.0 * z
    for group, part in zip(structure.groups, structure.parts, strict=True):
        if isinstance(group.nonlinearity, Hysteresis):
            values = {
                kind: torch.as_tensor(value).detach().cpu().numpy() for kind, value in part.of_group(parameters).items()
            }
            stiffness = np.broadcast_to(group.nonlinearity.stiffness_at_rest(values), (group.incidence.shape[0],))
            forces = part.states[0]
            for column, k in zip(range(forces.start, forces.stop), stiffness.tolist(), strict=True):
                if k > 0.0:
                    stored[..., column] = 0.5 * z[..., column] ** 2 / k
    return stored


def trapezoids(time: np.ndarray) -> np.ndarray:
    """(N,), s: weights of samples in an integral over the record."""
    step = np.diff(time)
    return 0.5 * (np.append(step, 0.0) + np.insert(step, 0, 0.0))
