"""What an excitation is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import ClassVar

import numpy as np

from pinn_cli.record.record import MINIMUM_SAMPLES, dof_mask
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import (
    USABLE,
    entries,
    is_usable_number,
    is_whole_number,
    positive_number,
    whole_number,
)


class Excitation(ABC):
    """An external force that is known at every time, so that a simulator can ask for it between the samples.

    A new one is a file here and a file in ``conf/excitation``; nothing else changes. It takes the record's ndof,
    duration and samples beside its own settings.

    Args:
        ndof: Degrees of freedom of the chain.
        duration: Of the record, s.
        samples: Of the record.
        dofs: The forced DOFs, counted from 1.

    Attributes:
        needs_force: Whether one DOF at least has to be forced.

    Raises:
        InputError: Naming ``simulation.<setting>`` or ``excitation.dofs``.
    """

    needs_force: ClassVar[bool] = True

    def __init__(self, ndof: int, duration: float, samples: int, dofs: Sequence[int]) -> None:
        self.ndof = ndof
        self.duration = positive_number("simulation.duration", duration)
        self.samples = whole_number("simulation.samples", samples, least=MINIMUM_SAMPLES)
        self.dofs = _checked_dofs(dofs, ndof) if self.needs_force or dofs else ()

    @property
    def forced(self) -> np.ndarray:
        """(ndof,) bool: the DOFs that carry a force."""
        return dof_mask(self.dofs, self.ndof)

    @property
    def nyquist(self) -> float:
        """Half the record's sampling rate, Hz."""
        return (self.samples - 1) / (2.0 * self.duration)

    @property
    def ground(self) -> Callable[[np.ndarray], np.ndarray] | None:
        """The ground's acceleration, (M,) s to (M,) m/s^2, at any times; None where it is at rest."""
        return None

    def force(self, time: np.ndarray) -> np.ndarray:
        """(time, ndof), N, at any times (time,), s; zero on the DOFs that carry none."""
        time = np.asarray(time, dtype=np.float64)
        force = np.zeros((len(time), self.ndof))
        force[:, np.asarray(self.dofs, dtype=int) - 1] = self.signals(time)
        return force

    @abstractmethod
    def signals(self, time: np.ndarray) -> np.ndarray:
        """(time, len(dofs)), or what broadcasts to it: the force on the forced DOFs, N, in the order of ``dofs``."""


def checked_band(band: Sequence[float], nyquist: float) -> tuple[float, float]:
    """The band as (low, high) in Hz, 0 <= low < high <= nyquist, or an InputError naming ``excitation.band``."""
    pair = entries(band)
    if len(pair) != 2 or not all(is_usable_number(x) for x in pair) or not 0 <= pair[0] < pair[1]:
        raise InputError("excitation.band", band, f"[low, high] in Hz with 0 <= low < high, 0 or {USABLE}")
    if pair[1] > nyquist:
        allowed = f"at most the Nyquist frequency of the record, {nyquist:.4g} Hz"
        raise InputError("excitation.band", band, allowed, "take more simulation.samples or a lower band")
    return float(pair[0]), float(pair[1])


def _checked_dofs(dofs: Sequence[int], ndof: int) -> tuple[int, ...]:
    numbers = entries(dofs)
    exist = all(is_whole_number(dof) and 1 <= dof <= ndof for dof in numbers)
    if not numbers or not exist or len(set(numbers)) < len(numbers):
        raise InputError("excitation.dofs", dofs, f"a list of different DOFs between 1 and system.ndof={ndof}")
    return tuple(int(dof) for dof in numbers)
