"""Rows that are features of time times coefficients which do not change: of sensors, and of linear equations.

A sum over products of such rows is one over products of features, the same for all functions and whatever the
parameters are, times matrices of the functions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_matrix
from torch import Tensor

# Windows of time whose features are kept: all of a record of ten thousand intervals, and of a longer one no more memory
# than that. Sums over them take a tenth of it, and are kept of all windows.
WINDOWS_KEPT = 8


def runs(first: np.ndarray, stride: int) -> list[tuple[slice, int]]:
    """Groups whose first features (I,) follow one another by a stride, and the first feature of the first of them."""
    breaks = np.flatnonzero(np.diff(first) != stride) + 1
    return [(slice(a, b), int(first[a])) for a, b in pairwise([0, *breaks.tolist(), len(first)])]


class LocalFeatures:
    """Features of I groups of S times, those of every derivative, and sums over them.

    Args:
        feature: (I, B) long, the features alive in each group.
        values: (I, S, orders, B).

    Attributes:
        first: Of the first group.
        constant: What :meth:`products` gives where all groups count alike; None: nobody has asked for it.
    """

    def __init__(self, feature: Tensor, values: Tensor) -> None:
        self.constant: list[tuple[int, list[np.ndarray]]] | None = None
        self.values, first = values.cpu().numpy(), feature[:, 0].cpu().numpy()
        # Runs of groups each of which begins as many features on, those of one output of a function.
        self.first, steps = int(first[0]), np.diff(first)
        self._stride = int(min(steps[steps > 0], default=1))
        self._runs = runs(first, self._stride)

    @cached_property
    def _lines(self) -> np.ndarray:
        """(B, S, orders, I), one feature after the other."""
        return np.ascontiguousarray(self.values.transpose(3, 1, 2, 0))

    def products(self, weight: np.ndarray | None) -> list[tuple[int, list[np.ndarray]]]:
        """Products of features summed over groups that follow one another, for every such run.

        Args:
            weight: (I,), of the groups; None: all count alike.

        Returns:
            The first feature F_0 of a run, and for every shift from 0 to B - 1 (F, orders squared): those of the
            features from F_0 on with the ones so much later.
        """
        if weight is not None:
            return list(self._summed(weight))
        self.constant = self.constant or list(self._summed(np.ones(len(self.values))))
        return self.constant

    def _summed(self, weight: np.ndarray) -> Iterator[tuple[int, list[np.ndarray]]]:
        groups, _, orders, features = self.values.shape
        add = self._add_by_group if groups < features else self._add_by_feature
        for part, first in self._runs:
            last = (part.stop - part.start - 1) * self._stride + 1
            out = [np.zeros((orders, orders, last - 1 + features - shift)) for shift in range(features)]
            add(out, part, weight[part])
            yield first, [np.ascontiguousarray(total.reshape(orders**2, -1).T) for total in out]

    def _add_by_group(self, out: list[np.ndarray], part: slice, weight: np.ndarray) -> None:
        """One group after the other: of few with many features."""
        _, times, orders, features = self.values.shape
        flat = self.values[part].reshape(-1, times, orders * features)
        gram = (flat.swapaxes(1, 2) * weight[:, None, None]) @ flat
        for group, products in enumerate(gram.reshape(-1, orders, features, orders, features)):
            for shift, total in enumerate(out):
                at = group * self._stride
                total[..., at : at + features - shift] += np.diagonal(products, shift, 1, 3)

    def _add_by_feature(self, out: list[np.ndarray], part: slice, weight: np.ndarray) -> None:
        """One pair of features after the other: of few in many groups."""
        lines, last = self._lines[..., part], (part.stop - part.start - 1) * self._stride + 1
        weighed = lines * weight
        for shift, total in enumerate(out):
            for b in range(len(lines) - shift):
                products = weighed[b, :, :, None] * lines[b + shift, :, None]
                total[..., b : b + last : self._stride] += products.sum(0)

    def against(self, histories: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
        """Features times histories (I, S, orders, C), summed; for every run its first feature, and (F, C)."""
        groups, times, orders, features = self.values.shape
        flat = self.values.reshape(groups, times * orders, features).swapaxes(1, 2)
        flat = flat @ histories.reshape(groups, times * orders, -1)
        for part, first in self._runs:
            last = (part.stop - part.start - 1) * self._stride + 1
            total = np.zeros((last - 1 + features, flat.shape[-1]))
            for b in range(features):
                total[b : b + last : self._stride] += flat[part, b]
            yield first, total


class FeatureWindows:
    """Features of the windows of a record; those that were asked for last are kept, and sums over all of them."""

    def __init__(self, make: Callable[[slice], LocalFeatures]) -> None:
        self._make, self._kept = make, dict[tuple[int | None, int | None], LocalFeatures]()
        self._constant: dict[tuple[int | None, int | None], list[tuple[int, list[np.ndarray]]] | None] = {}

    def __call__(self, part: slice) -> LocalFeatures:
        """Of some groups."""
        key = part.start, part.stop
        if key not in self._kept:
            if len(self._kept) >= WINDOWS_KEPT:
                self._constant |= {window: features.constant for window, features in self._kept.items()}
                self._kept.clear()
            self._kept[key] = self._make(part)
            self._kept[key].constant = self._constant.get(key)
        return self._kept[key]


@dataclass(frozen=True, eq=False)
class SeparableRows:
    """Linearised residuals that are features times coefficients, K at each time, in I groups of S times.

    Attributes:
        features: Of time.
        by_motion: (orders, K, functions), coefficients; the functions as they come.
        touching: (K, functions) bool, those that may be other than 0.
        weight: (K,), or (I, K).
        by: (I, S, K, F), what they are by parameters, and the residuals.
        places: (K, F), of those parameters; p, their number, of the residuals, and -1 where there is nothing.
        count: p.
    """

    features: LocalFeatures
    by_motion: np.ndarray
    touching: np.ndarray
    weight: np.ndarray
    by: np.ndarray
    places: np.ndarray
    count: int

    @property
    def pairs(self) -> np.ndarray:
        """(functions, functions) bool, those of one row."""
        meet: np.ndarray = self.touching.T.astype(float) @ self.touching > 0.0
        return meet

    def terms(self) -> Iterator[tuple[np.ndarray | None, np.ndarray]]:
        """Weights of :meth:`LocalFeatures.products`, and what these products are multiplied by.

        The latter are (orders squared, functions, functions), of the earlier feature's function and the later one's.
        Rows whose weight does not change are summed together, and each of the others alone.
        """
        weight = np.atleast_2d(self.weight)
        changes = (weight != weight[0]).any(0)
        terms: list[tuple[np.ndarray | None, np.ndarray]] = [(None, np.where(changes, 0.0, weight[0]))]
        terms += [(weight[:, row], np.arange(len(changes)) == row) for row in np.flatnonzero(changes)]
        for over_groups, over_rows in terms[int(changes.all()) :]:
            coupling = self.by_motion.swapaxes(1, 2)[:, None] @ (over_rows[:, None] * self.by_motion)
            yield over_groups, coupling.reshape(-1, *coupling.shape[2:])

    @property
    def meetings(self) -> tuple[np.ndarray, np.ndarray]:
        """Functions and places that stand in one row, R each."""
        row, slot = np.nonzero(self.places >= 0)
        named = np.zeros((len(self.places), self.count + 1))
        named[row, self.places[row, slot]] = 1.0
        function, place = np.nonzero(self.touching.T @ named)
        return function, place

    def beside(self) -> Iterator[tuple[int, np.ndarray]]:
        """Of every run the first feature, and what stands beside its band: (F, R), of the :attr:`meetings`."""
        (orders, _, functions), (function, place) = self.by_motion.shape, self.meetings
        number = np.zeros((functions, self.count + 1), dtype=np.int64)
        number[function, place] = np.arange(len(function))
        row, slot = np.nonzero(self.places >= 0)
        entry, by = np.nonzero(self.touching[row])
        target = np.arange(orders)[:, None] * len(function) + number[by, self.places[row, slot][entry]]
        values, source = self.by_motion[:, row[entry], by], np.broadcast_to(entry, target.shape)
        indices = target.reshape(-1), source.reshape(-1)
        into = csr_matrix((values.reshape(-1), indices), shape=(orders * len(function), len(row)))
        weight = self.weight[row] if self.weight.ndim == 1 else self.weight[:, None, row]
        weighed = self.by[..., row, slot] * weight
        pulled = into @ np.ascontiguousarray(weighed.reshape(-1, len(row)).T)
        pulled = pulled.reshape(orders, len(function), *weighed.shape[:2]).transpose(2, 3, 0, 1)
        yield from self.features.against(pulled)

    def of_parameters(self) -> np.ndarray:
        """(p, p + 1), of the parameters against each other and the residuals."""
        out = np.zeros((self.count + 1, self.count + 1))
        for row, places in enumerate(self.places):
            used = np.flatnonzero(places >= 0)
            columns = self.by[:, :, row, used]
            weight = self.weight[row] if self.weight.ndim == 1 else self.weight[:, row, None, None]
            weighed = (columns * weight).reshape(-1, len(used))
            np.add.at(out, np.ix_(places[used], places[used]), weighed.T @ columns.reshape(-1, len(used)))
        return out[:-1]
