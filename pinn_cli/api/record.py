"""Records that are built in Python, without the command."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np

from pinn_cli.record import record
from pinn_cli.record.response import GROUND, QUANTITIES, Response
from pinn_cli.record.simulated import Noise, add_noise
from pinn_cli.settings.errors import InputError

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Record(record.Record):
    """What sensors have measured; see :class:`pinn_cli.record.record.Record`.

    :meth:`pinn_cli.Structure.simulate` makes one, and ``run(..., data=record)`` takes one.

    Example:
        >>> import numpy as np
        >>> from pinn_cli import Structure
        >>> time = np.arange(500) / 50
        >>> record = Structure.chain(ndof=2, m=10.0, c=5.0, k=4e3).simulate(time, {2: np.sin(9.0 * time)})
        >>> record.keep({"acceleration": [1]}).with_noise(40.0).to_frame().columns.tolist()
        ['t', 'acceleration.1', 'force.2']
    """

    def with_noise(self, snr_db: float, seed: int = 0) -> Self:
        """The same with white Gaussian noise on every channel.

        Args:
            snr_db: 10 log10(signal power / noise power) of every channel.
            seed: The same seed gives the same noise; a channel's does not depend on which others there are.

        Raises:
            InputError: Naming ``noise.snr_db`` or ``seed``.
        """
        Noise(snr_db, seed)  # refuses what is no ratio
        clean = Response(**{name: getattr(self, name) for name in ("time", *QUANTITIES, GROUND)})
        return replace(self, **add_noise(clean, snr_db, seed).measurable)

    def to_frame(self) -> pd.DataFrame:
        """A column for each sensor, ``acceleration.3``, and the times ``t``, SI units: what `run` reads as data.

        Raises:
            InputError: It has sensors that are no columns.
        """
        import pandas as pd

        return pd.DataFrame(columns_of(self)[0])


def columns_of(given: record.Record) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """A record as columns by the names that `run` knows, and what else it says, as settings of `data`.

    Raises:
        InputError: It has sensors that are no columns.
    """
    if given.gauges:
        sensors = ", ".join(gauge.name for gauge in given.gauges)
        told = f"a record with the sensors {sensors}"
        raise InputError("data", told, "one whose sensors are columns", "give a frame")
    names = [given.dof_name(dof) for dof in range(given.ndof)]
    columns: dict[str, np.ndarray] = {"t": given.time}
    for quantity in QUANTITIES:
        for dof in np.flatnonzero(given.sensors(quantity)):
            columns[f"{quantity}.{names[dof]}"] = getattr(given, quantity)[:, dof]
    settings: dict[str, str] = {"intersample": given.intersample}
    if given.ground_acceleration is not None:
        columns[GROUND] = given.ground_acceleration
        settings["frame"] = given.frame
    return columns, settings


def unmeasured_forces(given: record.Record) -> list[str]:
    """Names of the DOFs that carry a force which nobody measured."""
    acting = ~given.unforced & ~given.sensors("force")
    return [given.dof_name(int(dof)) for dof in np.flatnonzero(acting)]
