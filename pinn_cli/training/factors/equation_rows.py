"""The linearised equation of motion, row by row in local terms: by the coordinates that a DOF is coupled with."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.system.connection_groups import Linearisation
from pinn_cli.system.functions import Jet
from pinn_cli.system.parameters import MASS
from pinn_cli.system.quantities import OUTSIDE_THE_EQUATIONS
from pinn_cli.system.structure import Structure
from pinn_cli.training.factors.factor import Residuals
from pinn_cli.training.factors.frame import EVERY, Frame
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_matrix.row_pattern import RowPattern
from pinn_cli.training.normal_matrix.row_sums import FullRows, Rows, RowSums, Touched
from pinn_cli.training.normal_matrix.separable_rows import FeatureWindows, LocalFeatures, SeparableRows
from pinn_cli.training.subdomains import Subdomains

# Numbers of rows, or of their products, that are held at once: a whole spline of a small chain, little enough for the
# caches, and no more than that for Fourier features.
ROW_NUMBERS_AT_ONCE = 2_000_000


@dataclass(frozen=True, eq=False)
class EquationRows:
    """Rows of m a + B' r, or of B' r alone, in the slots of a pattern.

    Attributes:
        pattern: Where the slots stand.
        stiffness, damping: Derivative by the displacements and velocities in the slots, each (I, S, n, D), or
            (1, 1, n, D) where none changes with time.
        mass: (n,), derivative by the acceleration of the row's own DOF; None without the inertia force.
        parameter: (I, S, n, kinds, F), derivative by the parameters in the slots, per prior standard deviation.
        changing: (n,) bool, the rows whose derivatives by the motion change with time: of what is nonlinear.
    """

    pattern: RowPattern
    stiffness: Tensor
    damping: Tensor
    mass: Tensor | None
    parameter: Tensor
    changing: np.ndarray

    @classmethod
    def of(
        cls,
        pattern: RowPattern,
        slope: Linearisation,
        mass: Tensor | None,
        acceleration: Tensor,
        spread: dict[str, Tensor],
    ) -> EquationRows:
        """Rows from the connections' linearisation.

        Args:
            pattern: Of the structure.
            slope: Derivatives of the internal forces, (I, S, C).
            mass: (n,) or None, see above.
            acceleration: (I, S, n), what a mass parameter multiplies: the motion's, or the observer's.
            spread: Kind of every uncertain parameter to the prior standard deviations of all its members, 0 of those
                that are held fixed.
        """
        slopes = [slope.stiffness, slope.damping]
        terms = np.any([(x != x[:1, :1]).flatten(0, 1).any(0).cpu().numpy() for x in slopes], axis=0)
        changing = pattern.entered(terms)
        stiffness, damping = (pattern.by_coordinate(x if terms.any() else x[:1, :1]) for x in slopes)
        parameter = pattern.by_parameter(own_by_parameter(pattern.dynamics.structure, slope, acceleration, spread))
        return cls(pattern, stiffness, damping, mass, parameter, changing)

    def applied(self, displacement: Tensor, velocity: Tensor, acceleration: Tensor) -> Tensor:
        """(I, S, n), the rows times a motion (I, S, n), parameters held."""
        if not self.changing.any():
            stiffness, damping = (torch.as_tensor(x).to(displacement) for x in self.by_motion[:2])
            out = displacement @ stiffness.T + velocity @ damping.T
        else:
            neighbours = self.pattern.neighbours
            out = (self.stiffness * neighbours(displacement) + self.damping * neighbours(velocity)).sum(-1)
        return out if self.mass is None else out + self.mass * acceleration

    def add_to(
        self,
        sums: RowSums,
        segments: Segments,
        residual: Tensor,
        weight: Tensor,
        averages: Subdomains | None = None,
        features: LocalFeatures | None = None,
    ) -> None:
        """Add the rows by readout weights and parameters, times the roots of their weights.

        Args:
            sums: To which.
            segments: Of the points, I groups of S.
            residual: (I, S, n), or (I, 1, n) of averages.
            weight: (n,), or as large as the residual.
            averages: Of the rows, where the residual is averaged.
            features: Averaged likewise, for rows that are these times constants.
        """
        rest = np.arange(len(self.changing))
        if averages is not None and features is not None and (self.pattern.is_full or not self.changing.any()):
            constant, rest = np.flatnonzero(~self.changing), np.flatnonzero(self.changing)
            if len(constant):
                sums.add_separable(self._separable(features, residual, weight, averages, constant))
        if not len(rest):
            return
        root = weight.broadcast_to(residual.shape).sqrt()
        root = root if averages is not None else root * segments.mask[..., None]
        if self.pattern.is_full:
            for full in self._by_group(segments, residual, root, averages, rest):
                sums.add_full(full)
        else:
            for rows in self._by_function(segments, residual, root, averages):
                sums.add(rows)

    @cached_property
    def by_motion(self) -> np.ndarray:
        """(orders, n, n), derivatives by the motion of rows that do not change; the functions as they come."""
        by_motion = [self.pattern.full(x[0, 0].cpu().numpy()) for x in (self.stiffness, self.damping)]
        return np.stack(by_motion if self.mass is None else [*by_motion, np.diag(self.mass.cpu().numpy())])

    @property
    def _at_every_time(self) -> tuple[Tensor, Tensor]:
        """Stiffness and damping, (I, S, n, D)."""
        times = self.parameter.shape[:2]
        return self.stiffness.expand(*times, -1, -1), self.damping.expand(*times, -1, -1)

    def _separable(
        self, features: LocalFeatures, residual: Tensor, weight: Tensor, averages: Subdomains, rows: np.ndarray
    ) -> SeparableRows:
        """Averages of some rows whose derivatives by the motion are constant; arguments as of :meth:`add_to`."""
        pattern, by_motion = self.pattern, self.by_motion[:, rows]
        parameter = averages(self.parameter[:, :, rows].flatten(2)).unflatten(2, (len(rows), -1))
        by = torch.cat((parameter, residual[..., rows, None]), -1).cpu().numpy()
        places = pattern.places[rows].reshape(len(rows), -1)
        places = np.column_stack((places, np.full(len(rows), pattern.count)))
        weights = (weight if weight.ndim == 1 else weight[:, 0])[..., rows].cpu().numpy()
        return SeparableRows(features, by_motion, pattern.touching[rows], weights, by, places, pattern.count)

    def _by_group(
        self, segments: Segments, residual: Tensor, root: Tensor, averages: Subdomains | None, rows: np.ndarray
    ) -> Iterator[FullRows]:
        """Some rows by all functions: those of all functions at once are as many rows of a group."""
        groups, features = segments.feature.shape
        residual, root = residual[..., rows], root[..., rows]
        numbers = residual[0].numel() * (features * len(self.pattern.coupled) + self.pattern.count + 1)
        chunk = max(1, ROW_NUMBERS_AT_ONCE // (features * numbers))
        for start in range(0, groups, chunk):
            part = slice(start, start + chunk)
            jacobian, parameter = self._by_every_function(segments, averages, part, rows)
            by_weight = (jacobian * root[part, ..., None, None]).flatten(1, 2)
            by = (torch.cat((parameter, residual[part, ..., None]), -1) * root[part, ..., None]).flatten(1, 2)
            yield FullRows(segments.feature[part], by_weight.numpy(), by.numpy(), self.pattern.reached)

    def _by_every_function(
        self, segments: Segments, averages: Subdomains | None, part: slice, rows: np.ndarray
    ) -> tuple[Tensor, Tensor]:
        """Some rows of some groups (I, S, r, B, n), or averages (I, 1, r, B, n); by parameters (I, S, r, places)."""
        pattern, count = self.pattern, len(rows)
        stiffness, damping = (pattern.every_function(x[part][:, :, rows], rows) for x in self._at_every_time)
        parameter = pattern.every_parameter(self.parameter[part][:, :, rows], rows)
        value, rate, curvature = segments.part(part).orders
        if averages is None:
            jacobian = value[:, :, None, :, None] * stiffness[:, :, :, None]
            jacobian += rate[:, :, None, :, None] * damping[:, :, :, None]
        else:
            share = averages.weight[part, :, None]
            jacobian = (value * share).mT @ stiffness.flatten(2) + (rate * share).mT @ damping.flatten(2)
            jacobian = jacobian.unflatten(-1, (count, -1)).movedim(1, 2)[:, None]
            curvature = (curvature * share).sum(1, keepdim=True)
            parameter = (share[..., None] * parameter).sum(1, keepdim=True)
        if self.mass is not None:
            rank = torch.as_tensor(pattern.rank[rows], device=jacobian.device)
            jacobian[:, :, torch.arange(count), :, rank] += (curvature[..., None] * self.mass[rows]).movedim(-1, 0)
        return jacobian, parameter

    def _by_function(
        self, segments: Segments, residual: Tensor, root: Tensor, averages: Subdomains | None
    ) -> Iterator[Rows]:
        """Every row by the functions in its slots: rows of one function after the other."""
        pattern, (groups, samples, n) = self.pattern, residual.shape
        width = len(pattern.offsets) * segments.feature.shape[1]
        chunk = n if averages is not None else max(1, ROW_NUMBERS_AT_ONCE // (groups * width * max(samples, width)))
        for first in range(0, n, chunk):
            count = min(chunk, n - first)
            dofs = pattern.standing(first, first + count)
            jacobian, parameter = self._in_slots(segments, averages, dofs)
            times = root[..., dofs, None]
            by = torch.cat((parameter, residual[..., dofs, None]), -1) * times
            features = (jacobian * times[..., None]).permute(3, 4, 1, 0, 2).contiguous().cpu().numpy()
            touched = []
            for slots, begin, end in pattern.runs:
                row, stop = max(begin - first, 0), min(end - first, count)
                if row < stop:
                    touched.append(Touched(first + pattern.offsets[slots.start], row, features[slots, ..., row:stop]))
            places = pattern.places[dofs].reshape(count, -1).T
            yield Rows(segments.feature, touched, places, by.permute(3, 1, 0, 2).contiguous().cpu().numpy())

    def _in_slots(
        self, segments: Segments, averages: Subdomains | None, dofs: slice | np.ndarray
    ) -> tuple[Tensor, Tensor]:
        """Rows of some DOFs (I, S, dofs, D, B), or averages (I, 1, dofs, D, B); by parameters (I, S, dofs, slots)."""
        if averages is None:
            slots = len(self.pattern.offsets), segments.feature.shape[1]
            jacobian = self.jacobian(segments, dofs).movedim(1, 2).unflatten(-1, slots)
            return jacobian, self.parameter[:, :, dofs].flatten(3)
        parameter = averages(self.parameter.flatten(2)).unflatten(2, (len(self.pattern.coupled), -1))[:, :, dofs]
        return self.averaged_jacobian(segments, averages).permute(0, 2, 3, 1)[:, None, dofs], parameter

    def jacobian(self, segments: Segments, dofs: slice | np.ndarray) -> Tensor:
        """The given DOFs' rows by the features of the DOFs in their slots, slot by slot, (I, dofs, S, D B)."""
        displacement, velocity = (phi[:, None, :, None, :] for phi in segments.orders[:2])
        stiffness, damping = (x[:, :, dofs].movedim(2, 1)[..., None] for x in (self.stiffness, self.damping))
        out = displacement * stiffness
        out.addcmul_(velocity, damping)
        if self.mass is not None:
            out[..., self.pattern.own_slot, :] += segments.orders[2][:, None] * self.mass[dofs, None, None]
        return out.flatten(3)

    def averaged_jacobian(self, segments: Segments, averages: Subdomains) -> Tensor:
        """The averages of all rows by the features of the DOFs in their slots, (I, B, n, D)."""
        share, slots = averages.weight[..., None], (len(self.pattern.coupled), len(self.pattern.offsets))
        stiffness, damping = self._at_every_time
        out = (segments.orders[0] * share).mT @ stiffness.flatten(2)
        out += (segments.orders[1] * share).mT @ damping.flatten(2)
        out = out.unflatten(-1, slots)
        if self.mass is not None:
            out[..., self.pattern.own_slot] += (segments.orders[2] * share).sum(1)[..., None] * self.mass
        return out


def own_by_parameter(
    structure: Structure, slope: Linearisation, acceleration: Tensor, spread: dict[str, Tensor]
) -> Tensor:
    """(I, S, carriers), what its parameter does to every connection or mass that has one, per prior standard deviation.

    Arguments as of :meth:`EquationRows.of`.
    """
    none = acceleration.new_zeros((*acceleration.shape[:-1], 1))
    blocks = []
    for kind, by in spread.items():
        if kind in OUTSIDE_THE_EQUATIONS:
            blocks.append(none * by)
        else:
            blocks.append(
                acceleration * by if kind == MASS else slope.by_parameter[kind] * by[structure.carriers[kind][1]]
            )
    return torch.cat(blocks, -1) if blocks else acceleration.new_zeros((*acceleration.shape[:-1], 0))


class EquationsOfMotion(Residuals):
    """Force that the motion takes minus the force that acts, N (paper, eq. 10c)."""

    name = "physics"

    def __init__(self, frame: Frame) -> None:
        super().__init__(frame)
        self.segments, target = frame.physics, frame.target
        self.acting, self._enforced = self.segments.gather(target.force), target.equation
        self._between = None if target.force_between is None else self.segments.gather(target.force_between)
        self._kept: tuple[Point | None, Tensor] = None, target.force
        self._features = FeatureWindows(self._averaged)

    def force(self, point: Point, part: slice = EVERY) -> Tensor:
        """(I, S, n), N, at the collocation points."""
        jet, parameters = self.frame.jet(self.segments, point, part), self.frame.parameters(point)
        return (self.frame.dynamics.residual(jet, parameters) - self.acting[part]) * self._enforced

    def residual(self, point: Point, part: slice = EVERY) -> Tensor:
        """As it is enforced: averages (I, 1, n), or (I, S, n); kept until the point changes."""
        if point is not self._kept[0]:
            windows = self.frame.windows(self.segments)
            forces = [self.frame.averaged(self.force(point, window), window) for window in windows]
            self._kept = point, torch.cat(forces) if len(forces) > 1 else forces[0]
        return self._kept[1][part]

    def weight(self, noise: NoiseModel) -> Tensor:
        """Discrepancy, load cells, and what the samples leave open between them."""
        like = self.frame.target.force
        variance = torch.as_tensor(noise.physics_variance).to(like)
        if self._between is not None:
            # The errors of neighbouring points go together: they do not average out.
            variance = variance + self.frame.averaged(self._between).square()
        return self._enforced / variance

    def rows(self, segments: Segments, point: Point, part: slice = EVERY) -> EquationRows:
        """Linearised at the times of any segments; in some groups alone."""
        frame = self.frame
        parameters, jet = frame.parameters(point), frame.jet(segments, point, part)
        slope, acceleration = frame.dynamics.linearise(jet, parameters), frame.dynamics.inertial_acceleration(jet)
        return EquationRows.of(frame.pattern, slope, frame.dynamics.mass(parameters), acceleration, frame.spread)

    def add_to(self, sums: RowSums, point: Point, noise: NoiseModel) -> None:
        """See :meth:`Factor.add_to`."""
        weight, every = self.weight(noise), self.frame.averages
        for part, residual in self.residuals(point):
            averages = None if every is None else every.part(part)
            rows, weighed = self.rows(self.segments, point, part), weight if weight.ndim == 1 else weight[part]
            features = None if averages is None else self._features(part)
            rows.add_to(sums, self.segments.part(part), residual, weighed, averages, features)

    def _averaged(self, part: slice) -> LocalFeatures:
        """Features of some averages, of every derivative."""
        averaged = self.frame.averaged(self.segments.jet[part], part)
        return LocalFeatures(self.segments.feature[part], averaged.transpose(1, 2))

    def moved(self, point: Point, steps: Sequence[Point]) -> Iterator[tuple[slice, list[Tensor]]]:
        """Window by window which groups, and how the residual, linearised at a point, changes with small steps."""
        for part in self.frame.windows(self.segments):
            rows, segments = self.rows(self.segments, point, part), self.segments.part(part)
            yield part, [self.frame.averaged(self._moved(rows, segments, step), part) for step in steps]

    def _moved(self, rows: EquationRows, segments: Segments, step: Point) -> Tensor:
        """(I, S, n), of some groups."""
        displacement, velocity, acceleration, _ = self.frame.fresh_states(segments, step)
        force = rows.applied(displacement, velocity, acceleration)
        if self.frame.vector.kinds:
            by = self.frame.pattern.of_parameters(self.frame.vector.placed(step.parameters))
            force = force + torch.einsum("isnkx,nkx->isn", rows.parameter, by)
        return force * self._enforced

    def mean_tangent(self, segments: Segments, point: Point) -> list[Tensor]:
        """Stiffness and damping of the terms of the linearised equations, each (T,), on the average over the times."""
        total: list[Tensor] = []
        for part in self.frame.windows(segments):
            slope = self.frame.dynamics.linearise(self.frame.jet(segments, point, part), self.frame.parameters(point))
            sums = [(x * segments.mask[part, :, None]).sum((0, 1)) for x in (slope.stiffness, slope.damping)]
            total = [before + now for before, now in zip(total, sums, strict=True)] if total else sums
        return [x / segments.mask.sum() for x in total]

    def own_by_parameter(self, segments: Segments, point: Point, part: slice = EVERY) -> Tensor:
        """(I, S, places), what each parameter does to its own connections or mass, per prior standard deviation."""
        frame = self.frame
        jet: Jet = frame.jet(segments, point, part)
        slope = frame.dynamics.linearise(jet, frame.parameters(point))
        acceleration = frame.dynamics.inertial_acceleration(jet)
        return frame.pattern.strength(own_by_parameter(frame.dynamics.structure, slope, acceleration, frame.spread))
