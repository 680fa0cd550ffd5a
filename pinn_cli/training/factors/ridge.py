"""A weak prior on the readout weights."""

from __future__ import annotations

import numpy as np
import torch

from pinn_cli.training.factors.factor import Factor
from pinn_cli.training.factors.frame import Frame
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_matrix.row_sums import RowSums

# Relative to the largest diagonal of the first normal matrix: keeps directions that nothing measures from running away.
# Fourier features on a period longer than the record have such directions: below 1e-15 their Gauss-Newton steps never
# settle; splines do not notice it.
RELATIVE_RIDGE = 1e-15


class Ridge(Factor):
    """Of every unknown: DOFs share one; modes, forces and the ground's acceleration have their own.

    Modes may be a million times as stiff as the lowest one is, whose ridge would then be no weak prior.

    Attributes:
        value: A number, or (functions,); None until the first normal matrix, on which it hangs, has been added up.
    """

    name = "ridge"

    def __init__(self, frame: Frame) -> None:
        super().__init__(frame)
        self.value: float | np.ndarray | None = None

    def loss(self, point: Point, noise: NoiseModel) -> float:
        """See :meth:`Factor.loss`."""
        if self.value is None:
            return 0.0
        return float((torch.as_tensor(self.of_unknowns).to(point.unknowns) * point.unknowns.square()).sum())

    def add_to(self, sums: RowSums, point: Point, noise: NoiseModel) -> None:
        """See :meth:`Factor.add_to`."""
        self.value = self._of(sums.main) if self.value is None else self.value
        sums.add_diagonal(self.of_unknowns, point.unknowns.numpy())

    @property
    def of_unknowns(self) -> float | np.ndarray:
        """A number, or (size,)."""
        if not isinstance(self.value, np.ndarray):
            return self.value or 0.0
        layout = self.frame.layout
        return layout.unknowns(torch.from_numpy(self.value).expand(layout.count, layout.ndof)).numpy()

    def _of(self, diagonal: np.ndarray) -> float | np.ndarray:
        dynamics, layout = self.frame.dynamics, self.frame.layout
        if dynamics.is_plain:
            return RELATIVE_RIDGE * float(diagonal.max())
        by_function = layout.weights(torch.from_numpy(diagonal))  # (count, functions)
        largest = by_function.amax(0)
        if not dynamics.structure.is_modal:
            largest[: dynamics.ndof] = largest[: dynamics.ndof].max()
        ridge: np.ndarray = RELATIVE_RIDGE * largest.numpy()
        return ridge
