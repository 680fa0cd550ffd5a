"""What a structure does under the force of a record and the motion of its ground."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.between_samples import BandLimited, between_samples
from pinn_cli.record.record import Record
from pinn_cli.record.response import Response
from pinn_cli.record.simulation import simulate
from pinn_cli.record.steps import TooStiffError as TooStiffError
from pinn_cli.record.steps import has_equation_of_motion, method_needed, with_slow_followers
from pinn_cli.record.supports import support_motion

if TYPE_CHECKING:
    from pinn_cli.system.structure import Structure


def resimulate(
    structure: Structure,
    record: Record,
    initial: Sequence[np.ndarray],
    force: np.ndarray | None = None,
    first: int = 0,
    ground: np.ndarray | None = None,
) -> Response:
    """The response of a structure to the force of a record, which does between samples what the record says.

    The measured motion of its ground acts as well; the acceleration is in the record's frame.

    Args:
        structure: Any.
        record: For its times, its ``intersample`` behaviour and its frame.
        initial: Displacement and velocity (n,) at sample ``first``.
        force: (N, n), N, another force at the record's samples; None: the record's own.
        first: Sample to begin with.
        ground: (N,), m/s^2, another ground acceleration at the record's samples; None: the record's own.

    Raises:
        OverflowsError: The response does not stay finite.
        TooStiffError: Even implicit steps would be too many, or a mass is zero.
    """
    if not has_equation_of_motion(structure):
        raise TooStiffError("a mass of it is zero")
    structure = with_slow_followers(structure, record.step)
    method, _ = method_needed(structure, record.step)
    time, force = record.time[first:], (record.force if force is None else force)[first:]
    moved = record.ground_acceleration if ground is None else ground
    shaking = None if moved is None else BandLimited(time, moved[first:])
    acting, carried = between_samples(time, force, record.intersample), support_motion(record, first)
    return simulate(
        structure,
        acting,
        time,
        acting.hold,
        method,
        initial=initial,
        ground=shaking,
        supports=carried,
        frame=record.frame,
    )
