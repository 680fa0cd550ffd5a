"""Which library computes: lets one elementwise formula serve torch tensors and numpy arrays.

An acceleration of one chain at one time costs 8 us in numpy and 34 us in torch, whose every call goes through a
dispatcher, so the simulator hands numpy arrays to the same formulas that the losses differentiate in torch.
"""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import torch

Array = TypeVar("Array", npt.NDArray[np.float64], torch.Tensor)


def namespace(x: np.ndarray | torch.Tensor) -> Any:
    """``numpy`` for a numpy array, ``torch`` for a tensor; both know ``concatenate``, ``where``, ``zeros_like``."""
    return np if isinstance(x, np.ndarray) else torch
