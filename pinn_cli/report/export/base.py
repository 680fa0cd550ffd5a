"""What every export of the response is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from pinn_cli.record.response import QUANTITIES

if TYPE_CHECKING:
    import xarray as xr


class Export(ABC):
    """Estimate and standard deviation of every quantity and DOF, in a file named ``response`` and the export's suffix.

    Attributes:
        name: As in ``report.export``.
    """

    name: ClassVar[str]

    def check(self) -> None:  # noqa: B027  # most need nothing
        """Refuse what this machine cannot write, before anything is estimated.

        Raises:
            InputError: A package is not installed.
        """

    @abstractmethod
    def write(self, dataset: xr.Dataset, path: Path) -> None:
        """Write the file, whole or not at all.

        Args:
            dataset: As `pinn_cli.report.dataset.response_dataset` makes it.
            path: Of the file.
        """


@dataclass(frozen=True, eq=False)
class History:
    """One quantity of one DOF.

    Attributes:
        quantity: displacement, velocity, acceleration or force.
        number: Of the DOF, from 1.
        dof: Its name, or its number as text.
        unit: SI.
        estimate, std: (N,).
    """

    quantity: str
    number: int
    dof: str
    unit: str
    estimate: np.ndarray
    std: np.ndarray


def histories(dataset: xr.Dataset) -> Iterator[History]:
    """Every quantity, DOF by DOF."""
    numbers = dataset["dof"].values
    names = dataset["dof_name"].values if "dof_name" in dataset.coords else numbers
    for quantity in QUANTITIES:
        estimate, std = dataset[quantity], dataset[f"{quantity}_std"].values
        for i, (number, name) in enumerate(zip(numbers, names, strict=True)):
            yield History(
                quantity, int(number), str(name), str(estimate.attrs["units"]), estimate.values[:, i], std[:, i]
            )
