"""Where the laws of connections are not smooth: no method of high order may step across such a corner."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pinn_cli.system.structure import Structure

# Half-width of the part of a step about a corner that is taken by itself, over the step: what a step across a corner is
# in error by falls with its square.
MARGIN = 1.0 / 128.0
# A law that turns over a speed is straight beyond so many times it, and takes steps of such a part of it.
STRAIGHT, FINE = 6.0, 0.3
# Loads at both ends of a step without supports that move.
AT_REST = (np.empty(0), np.empty(0))


@dataclass(frozen=True, eq=False)
class Corners:
    """Of the states of a structure: connections whose elongation turns round, and hidden forces that change sign.

    Attributes:
        rate: (corners, states), the elongations' rates from states in a row.
        width: (corners,), the speeds that the laws turn over, m/s; 0: at once.
        hidden: The hidden forces among the states.
        by_supports: (corners, S), the rates from the velocities of supports that move.
    """

    rate: np.ndarray
    width: np.ndarray
    hidden: slice
    by_supports: np.ndarray

    @classmethod
    def of(cls, structure: Structure) -> Corners | None:
        """Those of a structure; None where all its laws are smooth."""
        p = structure.parameters_like(np.empty(0))
        places, widths = [], []
        for group, part in zip(structure.groups, structure.parts, strict=True):
            width = group.nonlinearity.reversal_speed
            if width is not None:
                connections = np.arange(structure.incidence.shape[0])[part.connections]
                places.append(connections)
                widths.append(np.full(len(connections), width))
        if not places:
            return None
        n, hidden = len(p["m"]), len(structure.memory)
        rate = np.zeros((sum(map(len, places)), 2 * n + hidden))
        stretch = structure.stretch.matrix[np.concatenate(places)].toarray()
        rate[:, n : 2 * n] = stretch[:, :n]
        return cls(rate, np.concatenate(widths), slice(2 * n, 2 * n + hidden), stretch[:, n:])

    @property
    def shortest(self) -> float:
        """Least length of the parts that a step is divided into, over the step."""
        return MARGIN / 32.0 if self.width.any() else MARGIN

    def cuts(
        self, before: np.ndarray, after: np.ndarray, least: float, loads: Sequence[np.ndarray] = AT_REST
    ) -> np.ndarray:
        """Where a step from one state to another is divided, in ascending order, over the step; none: nowhere.

        Args:
            before: The state at the beginning.
            after: That at the end, if the step is taken at once.
            least: Distance of a cut from either end, over the step, at most a half. Without one, a step that begins
                at a corner would be divided there again and again.
            loads: At the beginning and at the end; they hold the velocity of supports that move.
        """
        first, last = (
            np.concatenate((self.rate @ state + self._of_supports(load), state[self.hidden]))
            for state, load in zip((before.reshape(-1), after.reshape(-1)), loads, strict=True)
        )
        sharp, wide = self._sharp & (first * last < 0.0), self._across(first, last)
        if not sharp.any() and not wide.any():
            return np.zeros(0)
        there = first[sharp] / (first[sharp] - last[sharp])
        cuts = [there - MARGIN, there + MARGIN]
        for x, y, width in zip(first[wide], last[wide], self._widths[wide], strict=True):
            ends = np.clip([x, y], -STRAIGHT * width, STRAIGHT * width)
            count = int(np.ceil(abs(ends[1] - ends[0]) / (FINE * width)))
            cuts.append((np.linspace(ends[0], ends[1], count + 1) - x) / (y - x))
        return np.unique(np.clip(np.concatenate(cuts), least, 1.0 - least))

    def _of_supports(self, load: np.ndarray) -> np.ndarray | float:
        moved = self.by_supports.shape[1]
        return self.by_supports @ load[1, -moved:] if moved else 0.0

    @cached_property
    def _widths(self) -> np.ndarray:
        return np.concatenate((self.width, np.zeros(self.hidden.stop - self.hidden.start)))

    @cached_property
    def _sharp(self) -> np.ndarray:
        return self._widths == 0.0

    def _across(self, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Whether a step is too long for a law that turns over a speed."""
        low, high, straight = np.minimum(first, last), np.maximum(first, last), STRAIGHT * self._widths
        return ~self._sharp & (high - low > FINE * self._widths) & (low < straight) & (high > -straight)
