"""Where the entries of a structure's linearised equations of motion stand, row by row."""

from __future__ import annotations

from functools import cached_property
from itertools import pairwise

import numpy as np
import torch
from scipy.sparse import csr_matrix
from torch import Tensor

from pinn_cli.system.coupling import Coupling
from pinn_cli.system.damping import WHOLE
from pinn_cli.system.dynamics import Dynamics
from pinn_cli.system.incidence import padded
from pinn_cli.system.parameters import MASS, ParameterVector
from pinn_cli.system.quantities import OUTSIDE_THE_EQUATIONS


class RowPattern:
    """Where the entries of a structure's equations of motion stand.

    A row has D slots, one for every offset from its DOF to those that are coupled with it, and F slots for every kind
    of parameter, one for every connection that pulls at the DOF. Of a chain D is 3 and F is 2. A parameter that several
    connections share has one slot in every row.

    Args:
        dynamics: Whose equations.
        vector: Of the uncertain parameters.
        like: A tensor of the dtype and device wanted.

    Attributes:
        order: (N,), the functions in the order that the band has them in; offsets are counted in it.
        offsets: (D,), from a function to those of its slots.
        coupled: (N, D) bool, the slots that are used; the others hold zeros.
        kinds: Of the parameters in the equations.
        places: (N, kinds, F), of each parameter's slot among the members of all the vector's kinds, -1 where unused.
        count: Members of all the vector's kinds.
        is_full: Whether rows are taken by all functions: most are coupled with most others, or those of a row stand
            apart in many distances.
    """

    _source: Tensor
    _sign: Tensor

    def __init__(self, dynamics: Dynamics, vector: ParameterVector[Tensor], like: Tensor) -> None:
        coupling = dynamics.coupling
        self.dynamics, self.vector = dynamics, vector
        self.offsets, self.coupled, self.reach = coupling.offsets, coupling.coupled, coupling.reach
        self.order, self.rank = coupling.order, coupling.rank
        self.own_slot = self.offsets.index(0)
        self.kinds = tuple(kind for kind in vector.kinds if kind not in OUTSIDE_THE_EQUATIONS)
        self.count = vector.places
        self._place_parameters(like)
        neighbours = np.where(self.coupled, coupling.neighbours, dynamics.size)
        self._neighbours, self._touching = (
            torch.as_tensor(index, device=like.device) for index in (neighbours, coupling.touching)
        )
        self._by_offset = torch.as_tensor(coupling.by_offset).to(like)
        # Of functions that are all coupled, one product with a matrix (C, n D) is faster than a sum over its terms.
        # So are rows whose functions stand apart in half as many distances as there are functions.
        count = len(self.coupled)
        scattered = len(self.runs) > 1 and 2 * len(self.offsets) >= count
        self.is_full = scattered or 2 * int(self.coupled.sum()) > count**2
        self._dense = torch.as_tensor(self._coefficients(coupling)).to(like) if self.is_full else None

    def _coefficients(self, coupling: Coupling) -> np.ndarray:
        """(T, n D), the derivatives of the rows in their slots by the terms."""
        rows, slots = len(self.coupled), len(self.offsets)
        out = np.zeros((coupling.into.shape[0] + 1, rows, slots))
        np.add.at(out, (coupling.touching, np.arange(rows)[:, None]), coupling.by_offset)
        return out[:-1].reshape(-1, rows * slots)

    def _place_parameters(self, like: Tensor) -> None:
        """Slots of the parameters: where each stands, and which connection of its kind acts in the row, how strongly.

        Connections that share a parameter add up in its slot: their rows are products with a matrix.
        """
        branches, vector, n = self.dynamics.branches, self.vector, self.dynamics.ndof
        structure = self.dynamics.structure
        shared = [k for k in self.kinds if k != MASS and len(structure.carriers[k][1]) > len(vector.nominal[k])]
        own_kinds = [kind for kind in self.kinds if kind not in (MASS, *shared)]
        touching, weight = _touching(branches.matrix, [self.dynamics.branch(kind) for kind in own_kinds])
        most = max([1, touching.shape[1], *(len(vector.nominal[kind]) for kind in shared)])
        shape = (self.dynamics.size, len(self.kinds), most)
        places, sources, sign = np.full(shape, -1), np.full(shape, -1), np.zeros(shape)
        self._shared: list[tuple[int, slice, Tensor]] = []
        start = 0
        for kind in vector.kinds:
            first, members = vector.first[kind], len(vector.nominal[kind])
            if kind not in self.kinds:
                start += members
                continue
            number = self.kinds.index(kind)
            which = np.arange(members) if kind == MASS else structure.carriers[kind][1]
            count = len(which)
            if kind == MASS:
                places[:n, number, 0], sources[:n, number, 0] = first + np.arange(n), start + np.arange(n)
                sign[:n, number, 0] = 1.0
            elif kind in shared:
                places[:, number, :members] = first + np.arange(members)
                pull = np.zeros((count, shape[0], most))
                pull[np.arange(count), :, which] = branches.matrix[self.dynamics.branch(kind)].toarray()
                matrix = torch.as_tensor(pull.reshape(count, -1)).to(like)
                self._shared.append((number, slice(start, start + count), matrix))
            else:
                member = np.full(branches.shape[0] + 1, -1)
                member[self.dynamics.branch(kind)] = np.arange(count)
                touched = member[touching]
                width = slice(0, touching.shape[1])
                places[:, number, width] = np.where(touched < 0, -1, first + touched)
                sources[:, number, width] = np.where(touched < 0, -1, start + touched)
                sign[:, number, width] = weight
            start += count
        self.places = places
        self._source = torch.as_tensor(np.where(sources < 0, start, sources), device=like.device)
        self._member = torch.as_tensor(np.where(places < 0, self.count, places), device=like.device)
        self._sign = torch.as_tensor(sign).to(like)

    def by_coordinate(self, x: Tensor) -> Tensor:
        """Derivative of B' r by the coordinates in the slots (..., n, D), from dr/de of the connections (..., C)."""
        if self._dense is not None:
            return (x @ self._dense).unflatten(-1, (len(self.coupled), -1))
        ends = [_with_none(x)[..., column] for column in self._touching.T]
        slots = [
            sum(end * self._by_offset[:, i, slot] for i, end in enumerate(ends)) for slot in range(len(self.offsets))
        ]
        return torch.stack([slot if isinstance(slot, Tensor) else x.new_zeros(()) for slot in slots], -1)

    def neighbours(self, x: Tensor) -> Tensor:
        """Motion of the coordinates in the slots, (..., n) to (..., n, D); what there is not does not move."""
        return _with_none(x)[..., self._neighbours]

    def full(self, slots: np.ndarray) -> np.ndarray:
        """(n, n), of one value in every slot (n, D)."""
        row, slot = np.nonzero(self.coupled)
        out = np.zeros((len(slots), len(slots)))
        np.add.at(out, (row, self.dynamics.coupling.neighbours[row, slot]), slots[row, slot])
        return out

    def by_parameter(self, slopes: Tensor) -> Tensor:
        """(..., n, kinds, F), rows by parameter, from what they do to every connection or mass that has one."""
        rows = _with_none(slopes)[..., self._source] * self._sign
        for number, part, pull in self._shared:
            rows[..., number, :] = (slopes[..., part] @ pull).unflatten(-1, (len(self.coupled), -1))
        return rows

    def strength(self, slopes: Tensor) -> Tensor:
        """(..., count), the size of what each parameter does to its own connection or mass; see :meth:`by_parameter`.

        One that several connections share pulls at many coordinates, and so does a connection of modes: then it is the
        length of that pull.
        """
        blocks, start = [], 0
        pulls = {self.kinds[number]: (part, pull) for number, part, pull in self._shared}
        for kind in self.vector.kinds:
            members = len(self.vector.nominal[kind])
            if kind in pulls:
                part, pull = pulls[kind]
                rows = (slopes[..., part] @ pull).unflatten(-1, (len(self.coupled), -1))
                blocks.append(rows.square().sum(-2).sqrt()[..., :members])
                start = part.stop
            else:
                blocks.append(slopes[..., start : start + members] * self._length(kind, slopes))
                start += members
        return torch.cat(blocks, -1)

    def _length(self, kind: str, like: Tensor) -> Tensor | float:
        """How far the coordinates pull at every connection of a kind; DOFs at those between them by one."""
        between = not self.dynamics.structure.is_modal and kind not in WHOLE
        if between or kind not in self.kinds or kind == MASS:
            return 1.0
        pull = self.dynamics.branches.matrix[self.dynamics.branch(kind)]
        return torch.as_tensor(np.sqrt(pull.power(2).sum(axis=1)).A1).to(like)

    @cached_property
    def natural(self) -> bool:
        """Whether the functions stand in the band as they come."""
        return np.array_equal(self.order, np.arange(len(self.order)))

    @cached_property
    def reached(self) -> np.ndarray:
        """(n, places) bool, which parameters stand in a row of which function, in the band's order."""
        named = np.zeros((len(self.coupled), self.count + 1), dtype=bool)
        flat = self.places.reshape(len(self.coupled), -1)
        named[np.arange(len(flat))[:, None], flat] = True
        reached: np.ndarray = self.touching.T.astype(float) @ named[:, :-1] > 0.0
        return reached[self.order]

    @cached_property
    def touching(self) -> np.ndarray:
        """(n, n) bool, which functions stand in a row, as they come."""
        touching: np.ndarray = self.full(self.coupled.astype(float)) > 0.0
        return touching

    def standing(self, first: int, stop: int) -> slice | np.ndarray:
        """The functions at some places of the band; a slice takes no copies."""
        functions: np.ndarray = self.order[first:stop]
        return slice(first, stop) if self.natural else functions

    def in_order(self, values: Tensor) -> Tensor:
        """Values (..., n) of the functions in the band's order."""
        return values if self.natural else values[..., torch.as_tensor(self.order, device=values.device)]

    @cached_property
    def runs(self) -> list[tuple[slice, int, int]]:
        """Slots that most rows use, neighbours together, and others one by one: which, the first row and the last.

        Rows are in the band's order.
        """
        coupled = self.coupled[self.order]
        often = 2 * coupled.sum(axis=0) > len(coupled)
        breaks = (np.diff(self.offsets) != 1) | ~(often[1:] & often[:-1])
        edges = [0, *(np.flatnonzero(breaks) + 1).tolist(), len(self.offsets)]
        runs = []
        for start, stop in pairwise(edges):
            rows = np.flatnonzero(coupled[:, start:stop].any(axis=1))
            runs.append((slice(start, stop), int(rows[0]), int(rows[-1]) + 1))
        return runs

    def entered(self, terms: np.ndarray) -> np.ndarray:
        """(n,) bool, the rows that some of the terms (T,) bool of the coupling enter."""
        entered: np.ndarray = abs(self.dynamics.coupling.into).T @ terms.astype(float) > 0.0
        return entered

    def every_function(self, slots: Tensor, rows: np.ndarray) -> Tensor:
        """Derivatives of rows by all functions in the band's order (..., r, n), by those in the slots (..., r, D)."""
        out = slots.new_zeros((*slots.shape[:-1], len(self.coupled) + 1))
        out.scatter_(-1, self._neighbours[rows].expand(slots.shape), slots)
        return self.in_order(out[..., :-1])

    def every_parameter(self, slots: Tensor, rows: np.ndarray) -> Tensor:
        """(..., r, places), derivatives of rows by all members, from those in the slots (..., r, kinds, F)."""
        flat = slots.flatten(-2)
        out = slots.new_zeros((*flat.shape[:-1], self.count + 1))
        return out.scatter_add_(-1, self._member[rows].flatten(-2).expand(flat.shape), flat)[..., :-1]

    def of_parameters(self, values: Tensor) -> Tensor:
        """(n, kinds, F), values of all members (count,) in the slots; 0 where unused."""
        return _with_none(values)[self._member]

    def uncertain_columns(self, parameter: Tensor, dof: int) -> Tensor:
        """Rows of one DOF by every uncertain parameter, (..., kinds, F) to (..., p)."""
        every = self.every_parameter(parameter[..., None, :, :], np.array([dof]))[..., 0, :]
        return every[..., torch.as_tensor(self.vector.column, device=parameter.device)]


def _touching(matrix: csr_matrix, branches: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """(N, F), the chosen branches that pull at each function, ascending, their number where there is none; weights."""
    chosen = np.zeros(matrix.shape[0])
    chosen[np.concatenate([np.zeros(0, dtype=np.int64), *branches])] = 1.0
    kept = csr_matrix(matrix.multiply(chosen[:, None]))
    kept.eliminate_zeros()
    places, weights = padded(kept.T.tocsr())
    return np.where(weights == 0, matrix.shape[0], places), weights


def _with_none(x: Tensor) -> Tensor:
    """(..., N) with a zero behind it, in the place of what there is not."""
    return torch.cat((x, x.new_zeros((*x.shape[:-1], 1))), -1)
