"""The equations of all functions of time: motion, memory of connections, ground, unknown forces.

Averaged over the knot intervals of local features, see :mod:`pinn_cli.training.subdomains`; at every collocation
point of others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from pinn_cli.network.linear_readout import Segments
from pinn_cli.system.functions import Jet
from pinn_cli.training.factors.equation_rows import EquationRows, own_by_parameter
from pinn_cli.training.factors.factor import Residuals
from pinn_cli.training.factors.frame import EVERY, Frame
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_matrix.row_sums import RowSums
from pinn_cli.training.normal_matrix.separable_rows import FeatureWindows, LocalFeatures
from pinn_cli.training.point import Point


class EquationsOfMotion(Residuals):
    """Force that the motion takes minus the force that acts, N (paper, eq. 10c).

    Args:
        frame: Of the record.

    Attributes:
        averages: Over the knot intervals; None: the equations hold at every point.
    """

    name = "physics"

    def __init__(self, frame: Frame) -> None:
        super().__init__(frame)
        self.segments, self.averages, target = frame.physics, frame.averages, frame.target
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
            forces = []
            for window in self.frame.windows(self.segments):
                force = self.force(point, window)
                forces.append(force if self.averages is None else self.averages.part(window)(force))
            self._kept = point, torch.cat(forces) if len(forces) > 1 else forces[0]
        return self._kept[1][part]

    def weight(self, noise: NoiseModel) -> Tensor:
        """Discrepancy, load cells, and what the samples leave open between them."""
        like = self.frame.target.force
        variance = torch.as_tensor(noise.physics_variance).to(like)
        if self._between is not None:
            # The errors of neighbouring points go together: they do not average out.
            between = self._between if self.averages is None else self.averages(self._between)
            variance = variance + between.square()
        return self._enforced / variance

    def rows(self, segments: Segments, point: Point, part: slice = EVERY) -> EquationRows:
        """Linearised at the times of any segments; in some groups alone."""
        frame = self.frame
        parameters, jet = frame.parameters(point), frame.jet(segments, point, part)
        slope, acceleration = frame.dynamics.linearise(jet, parameters), frame.dynamics.inertial_acceleration(jet)
        return EquationRows.of(frame.pattern, slope, frame.dynamics.mass(parameters), acceleration, frame.spread)

    def add_to(self, sums: RowSums, point: Point, noise: NoiseModel) -> None:
        """See :meth:`Factor.add_to`."""
        weight = self.weight(noise)
        for part, residual in self.residuals(point):
            averages = None if self.averages is None else self.averages.part(part)
            rows, weighed = self.rows(self.segments, point, part), weight if weight.ndim == 1 else weight[part]
            features = None if averages is None else self._features(part)
            rows.add_to(sums, self.segments.part(part), residual, weighed, averages, features)

    def _averaged(self, part: slice) -> LocalFeatures:
        """Features of some averages, of every derivative."""
        assert self.averages is not None
        of, share = self.segments, self.averages.weight[part, :, None]
        features = [(phi[part] * share).sum(1) for phi in (of.displacement, of.velocity, of.acceleration)]
        return LocalFeatures(of.feature[part], torch.stack(features, 1)[:, None])

    def moved(self, point: Point, steps: Sequence[Point]) -> Iterator[tuple[slice, list[Tensor]]]:
        """Window by window which groups, and how the residual changes with small steps.

        Args:
            point: Where it is linearised.
            steps: Whose ``unknowns`` and ``parameters`` are changes.
        """
        for part in self.frame.windows(self.segments):
            rows, segments = self.rows(self.segments, point, part), self.segments.part(part)
            averages = None if self.averages is None else self.averages.part(part)
            moved = [self._moved(rows, segments, step) for step in steps]
            yield part, moved if averages is None else [averages(force) for force in moved]

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
