"""What a structure does under the measured force and the ground's motion alone: no response sensor is looked at."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.between_samples import BandLimited, between_samples
from pinn_cli.record.simulation import OverflowsError, simulate
from pinn_cli.record.steps import TooStiffError, method_needed, with_slow_followers
from pinn_cli.record.supports import support_motion
from pinn_cli.system.modes import Modes, modes_of
from pinn_cli.system.support import loose_dofs
from pinn_cli.verdict.linear_response import decays, felt_modes, linear_response

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pinn_cli.record.channels import Channel
    from pinn_cli.record.record import Record
    from pinn_cli.record.response import Response
    from pinn_cli.system.structure import Structure

# Steps of Runge-Kutta, 45 us each: a nonlinear chain is followed for the first part of a longer record only.
MOST_STEPS = 40_000
# Steps of Runge-Kutta that take as long as the implicit steps of a sample.
OF_IMPLICIT = 10
LINEAR = ("m", "c", "k")


@dataclass(frozen=True, eq=False)
class Prediction:
    """A response to the measured force, and the part of the record that it is of.

    Attributes:
        response: (M, n) each, up to free decays.
        record: Its first M samples.
        modes: Of the structure without its nonlinearity, whose free decays count as part of the prediction.
    """

    response: Response
    record: Record
    modes: Modes
    _decays: dict[tuple[int, ...], np.ndarray] = field(default_factory=dict)

    def decays(self, channel: Channel) -> np.ndarray:
        """See :func:`pinn_cli.verdict.linear_response.decays`; channels that feel the same modes share theirs."""
        seen = felt_modes(self.modes, channel)
        if seen not in self._decays:
            self._decays[seen] = decays(self.modes, seen, self.record)
        return self._decays[seen]


def predicted(structure: Structure, record: Record, start: Sequence[np.ndarray] | None = None) -> Prediction | None:
    """The response of a structure to the record's force; None where a force is unknown or the structure is unstable.

    Args:
        structure: Any. A linear one is solved in the frequency domain, exactly and in milliseconds; another one is
            simulated from ``start`` on.
        record: For its force and its times.
        start: Displacement and velocity (n,) at the first sample; None: rest. Of a linear chain it does not matter.
    """
    if not np.isfinite(record.force).all():
        return None
    parameters = structure.parameters_like(np.empty(0))
    if not all(np.isfinite(value).all() for value in parameters.values()) or (parameters["m"] <= 0).any():
        return None
    modes = modes_of(structure)
    # A body that nothing holds has no response that repeats itself: it is simulated.
    if is_linear(structure) and not loose_dofs(structure):
        response = linear_response(modes, record)
        finite = np.isfinite(response.displacement).all() and modes.stable
        return Prediction(response, record, modes) if finite else None
    structure = with_slow_followers(structure, record.step)
    method, substeps = method_needed(structure, record.step)
    samples = min(len(record.time), MOST_STEPS // (substeps if method == "rk4" else OF_IMPLICIT))
    if samples < len(modes.poles) * 8:
        return None
    part = record.until(samples)
    moved = part.ground_acceleration
    ground = None if moved is None else BandLimited(part.time, moved)
    force = between_samples(part.time, part.force, part.intersample)
    try:
        response = simulate(
            structure, force, part.time, force.hold, method, substeps, initial=start, ground=ground,
            supports=support_motion(record), frame=record.frame,
        )  # fmt: skip
    except (OverflowsError, TooStiffError):
        return None
    return Prediction(response, part, modes)


def is_linear(structure: Structure) -> bool:
    """Whether every nonlinear parameter of a structure is zero."""
    return not any(bool(value.any()) for name, value in structure.parameters.items() if name not in LINEAR)
