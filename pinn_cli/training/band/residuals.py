"""Residuals of a linear-readout network and their linearised rows, in windows of time.

What is as long as the record is held for a window alone, wherever a sum over windows is asked for: memory then grows
with the unknowns, and arrays stay so small that the system need not clear new pages for each.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import torch
from torch import Tensor

from pinn_cli.network.base import States
from pinn_cli.network.linear_readout import LinearReadout, Segments
from pinn_cli.network.spline import POINTS_PER_INTERVAL, SplineNetwork
from pinn_cli.physics import observation_masks, observation_residuals, physics_residual, targets
from pinn_cli.record.record import Record
from pinn_cli.record.response import GROUND
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.functions import Jet
from pinn_cli.system.parameters import ParameterVector
from pinn_cli.system.quantities import FORCE, OUTSIDE_THE_EQUATIONS, SUPPORT
from pinn_cli.training.band.beginning import Beginning
from pinn_cli.training.band.equation_rows import EquationRows, own_by_parameter
from pinn_cli.training.band.gauge_rows import GaugeRows, calibrations
from pinn_cli.training.band.input_rows import InputRows
from pinn_cli.training.band.layout import BandLayout
from pinn_cli.training.band.point import Point
from pinn_cli.training.band.row_pattern import RowPattern
from pinn_cli.training.band.subdomains import Subdomains
from pinn_cli.training.whittle.whittle_estimate import KnownParameters

# Numbers of the linearised equation of motion that are held at once: little enough for the caches.
ROWS_AT_ONCE = 1_000_000
# Numbers of a motion up to which all its windows are kept until the point changes; of a longer one the last is.
KEPT = 4_000_000
# Covariances that are taken from the inverse at once, at least.
FEWEST_COVARIANCES = 64
EVERY = slice(None)


def _by_interval(network: LinearReadout) -> bool:
    """Whether the equation of motion can be averaged over the intervals of local features."""
    return isinstance(network, SplineNetwork) and network.channels == 1 and network.degree % 2 == 0


def collocation_refinement(network: LinearReadout, record: Record) -> int:
    """Collocation points for every sample, so that each knot interval has its own.

    A force that is held has one value for every step and no others.
    """
    if record.intersample != "band_limited" or not isinstance(network, SplineNetwork):
        return 1
    return max(1, math.ceil(POINTS_PER_INTERVAL * record.step / network.spacing - 1e-6))


class Residuals:
    """What a network, a structure and a record have to do with each other at a point.

    Residuals and states are grouped as the network's segments are, (I, S, n), and 0 at padding.

    Args:
        network: Fixed features, linear readout, an output for every unknown function.
        problem: Structure, record, uncertain parameters.
        device: Where residuals and blocks are computed.
        known: Parameters of a linear structure that something else has told; None: they are solved for.
    """

    def __init__(
        self,
        network: LinearReadout,
        problem: Problem,
        device: str = "cpu",
        known: KnownParameters | None = None,
    ) -> None:
        self.known, self.is_linear = known, known is not None
        self.problem, self.dynamics, self.is_plain = problem, problem.dynamics, problem.dynamics.is_plain
        self.refinement = collocation_refinement(network, problem.record)
        self.target = targets(problem.record, self.dynamics, device, refinement=self.refinement)
        self.network = network.to(device)
        self.observation = network.segments(self.target.observation_time)
        self.physics = network.segments(self.target.physics_time)
        self.averages = Subdomains(self.physics) if _by_interval(network) else None
        self.physics = self.physics if self.averages is None else self.averages.segments
        if self.averages is not None and problem.turns is not None:
            assert isinstance(network, SplineNetwork)
            near = problem.turns.near(self.averages.times(self.target.physics_time), network.spacing)
            self.averages = self.averages.loosened(torch.as_tensor(near), problem.turns.looser)
        self.inputs = {
            quantity: InputRows(
                quantity, problem.record, there.cpu().numpy(), self.network, self.dynamics, self.refinement
            )
            for quantity, there in self.target.sensors.items()
            if quantity in (GROUND, FORCE, *SUPPORT) and bool(there.any())
        }
        self.observation_target = self.target.grouped_observations(self.observation.gather)
        self.physics_target = self.target.grouped_collocation(self.physics.gather)
        self.beginning = Beginning.of(problem)
        prescribed = problem.structure.parameters | calibrations(problem.record.gauges)
        prescribed |= {} if self.beginning is None else self.beginning.prescribed
        self.prescribed = {name: value.to(self.target.force) for name, value in prescribed.items()}
        self._place_parameters()
        self.pattern = RowPattern(self.dynamics, self.vector, self.target.force)
        self.layout = BandLayout(self.physics.feature, self.physics.count, self.pattern)
        self.gauge_rows = [
            GaugeRows(gauge, i, self.network, self.dynamics, self.layout, self.vector, self.target.force)
            for i, gauge in enumerate(self.problem.record.gauges)
        ]
        self._kept_point: Point | None = None
        self._kept_states: dict[tuple[int, int | None, int | None], States] = {}
        self._kept_squares: dict[str, Tensor] | None = None
        self._kept_physics: Tensor | None = None

    @cached_property
    def forces(self) -> Segments:
        """The features at the times of the force samples: those of :attr:`physics`, where every point is a sample."""
        if self.refinement == 1:
            return self.physics
        times = self.target.physics_time[:: self.refinement]
        return self.observation if torch.equal(times, self.target.observation_time) else self.network.segments(times)

    def _place_parameters(self) -> None:
        like = self.target.force
        self.uncertain = self.problem.uncertain if self.beginning is None else self.beginning.uncertain
        self.vector = ParameterVector(self.prescribed, self.uncertain)
        self.scale = torch.as_tensor(self.vector.each("prior_std"), dtype=like.dtype, device=like.device)
        # What is believed of a sensor, or of a first state, has nothing to do with how well the structure is known.
        alone = [p.unknown or p.kind in OUTSIDE_THE_EQUATIONS for p in self.uncertain]
        self.unknown = torch.as_tensor(alone, dtype=torch.bool, device=like.device)
        self.lower = self.vector.each("lower") / self.vector.each("prior_std")
        # 0 where a parameter is held fixed: its column then vanishes.
        self.spread = self.vector.scattered(self.scale)

    def start(self) -> Point:
        """The structure at rest with its prescribed parameters, or with those that are known."""
        zeros = self.target.force.new_zeros
        parameters = zeros(len(self.scale)) if self.known is None else torch.as_tensor(self.known.distance)
        return Point(zeros(self.layout.size), parameters.to(self.target.force))

    def readout(self, point: Point) -> Tensor:
        """The readout weights of a point as the network keeps them, (channels, count, ndof)."""
        return self.layout.weights(point.unknowns).unflatten(0, (-1, self.network.channels)).movedim(1, 0).contiguous()

    def parameters(self, point: Point) -> dict[str, Tensor]:
        """Every parameter of the structure by kind at a point."""
        return self.vector.values(self.scale * point.parameters)

    def windows(self, segments: Segments, width: int = 0) -> list[slice]:
        """Groups whose linearised equations of motion are held at once, one range after the other.

        Args:
            segments: The groups.
            width: Of the covariance that each group needs besides.
        """
        groups, samples = segments.mask.shape
        places = self.pattern.places[0].size
        size = max(1, ROWS_AT_ONCE // (samples * self.dynamics.size * (2 * len(self.pattern.offsets) + places)))
        size = min(size, max(FEWEST_COVARIANCES, ROWS_AT_ONCE // width**2)) if width else size
        return [slice(start, min(start + size, groups)) for start in range(0, groups, size)]

    def _keep(self, point: Point) -> None:
        """Forget what is known of another point."""
        if point is not self._kept_point:
            self._kept_point, self._kept_states = point, {}
            self._kept_squares = self._kept_physics = None

    def states(self, segments: Segments, point: Point, part: slice = EVERY) -> States:
        """Motion at a point, of some groups; residuals, rows and losses all ask for it."""
        self._keep(point)
        key = id(segments), part.start, part.stop
        if key not in self._kept_states:
            if segments.mask.numel() * self.dynamics.size > KEPT:
                self._kept_states = {}
            self._kept_states[key] = self._states(segments.part(part), point)
        return self._kept_states[key]

    def _states(self, segments: Segments, point: Point) -> States:
        local = self.layout.weights(point.unknowns)[segments.feature]
        continuity = None if segments.continuity is None else segments.continuity @ local
        return States(
            segments.displacement @ local, segments.velocity @ local, segments.acceleration @ local, continuity
        )

    def jet(self, segments: Segments, point: Point, part: slice = EVERY) -> Jet:
        """The same without what separate outputs leave between them."""
        return Jet(*self.states(segments, point, part)[:3])

    def flat_states(self, segments: Segments, point: Point) -> States:
        """Motion at a point in the order of the times, each (N, n)."""
        flat: list[Tensor] = []
        for part in self.windows(segments):
            group = segments.part(part)
            motion = self._states(group, point)[:3]
            flat = flat or [values.new_zeros((segments.samples, values.shape[-1])) for values in motion]
            for out, values in zip(flat, motion, strict=True):
                group.place(values, out)
        displacement, velocity, acceleration = flat
        return States(displacement, velocity, acceleration, None)

    def residuals(self, point: Point) -> dict[str, Tensor]:
        """Residuals by name: ``physics``, ``continuity``, those of :func:`pinn_cli.physics.observation_masks`.

        That of the physics is one of averages (I, 1, n) where there are :attr:`averages`, the others are (I, S, n).
        """
        every: dict[str, list[Tensor]] = {}
        for _, found in self.in_windows(point):
            for name, residual in found.items():
                every.setdefault(name, []).append(residual)
        return {name: torch.cat(each) if len(each) > 1 else each[0] for name, each in every.items()}

    def in_windows(self, point: Point) -> Iterator[tuple[slice, dict[str, Tensor]]]:
        """The same window by window: of sensors, of inputs' sensors, of equations; which groups, and residuals."""
        parameters, through = self.parameters(point), self.problem.acceleration_through
        if observation_masks(self.target, through):
            for part in self.windows(self.observation):
                target = self.observation_target.of_groups(part)
                states = self.states(self.observation, point, part)
                found = observation_residuals(states, target, self.dynamics, parameters, through)
                yield part, {name: residual for name, residual in found.items() if name not in self.inputs}
        for name, rows in self.inputs.items():
            for part in self.windows(rows.segments):
                yield part, {name: rows.residual(self.states(rows.segments, point, part), part)}
        physics = self.physics_residual(point)
        for part in self.windows(self.physics):
            found = {"physics": physics[part]}
            if self.physics.continuity is not None:
                continuity = self.states(self.physics, point, part).continuity
                assert continuity is not None
                found["continuity"] = continuity
            yield part, found

    def squares(self, point: Point) -> dict[str, Tensor]:
        """Sums of squares (n,) of the residuals, but for those of the physics; kept until the point changes."""
        self._keep(point)
        if self._kept_squares is None:
            total: dict[str, Tensor] = {}
            for _, found in self.in_windows(point):
                for name, residual in found.items():
                    if name != "physics":
                        square = residual.square().sum((0, 1))
                        total[name] = total[name] + square if name in total else square
            self._kept_squares = total
        return self._kept_squares

    def physics_residual(self, point: Point) -> Tensor:
        """The physics residual as it is enforced: averages (I, 1, n), or (I, S, n); kept until the point changes."""
        self._keep(point)
        if self._kept_physics is None:
            every = []
            for part in self.windows(self.physics):
                forces = self.force_residual(point, part)
                every.append(forces if self.averages is None else self.averages.part(part)(forces))
            self._kept_physics = torch.cat(every) if len(every) > 1 else every[0]
        return self._kept_physics

    def force_residual(self, point: Point, part: slice = EVERY) -> Tensor:
        """Force that the motion takes minus the force that acts, at the collocation points, (I, S, n), N."""
        states, target = self.states(self.physics, point, part), self.physics_target
        target = target if part == EVERY else replace(target, force=target.force[part])
        return physics_residual(states, target, self.dynamics, self.parameters(point))

    def gauge_residuals(self, point: Point) -> list[Tensor]:
        """Of every gauge, what it would show without noise minus what it shows, (I, S), 0 at padding."""
        parameters = self.parameters(point)
        return [rows.residual(point.unknowns, parameters) for rows in self.gauge_rows]

    def moved_gauges(self, point: Point, step: Point) -> list[Tensor]:
        """Change of what every gauge would show with a small step of weights and parameters, each (I, S)."""
        parameters = self.parameters(point)
        spread, by = self.vector.placed(self.scale), self.vector.placed(step.parameters)
        return [rows.moved(point.unknowns, parameters, step.unknowns, by, spread) for rows in self.gauge_rows]

    def rows(self, segments: Segments, point: Point, with_mass: bool = True, part: slice = EVERY) -> EquationRows:
        """Linearised equation of motion at a point, with or without its inertia force; in some groups alone."""
        parameters = self.parameters(point)
        jet = self.jet(segments, point, part)
        slope, acceleration = self.dynamics.linearise(jet, parameters), self.dynamics.inertial_acceleration(jet)
        if not with_mass:
            force = self.observation_target.observer_force[part]
            acceleration = self.dynamics.structure.acceleration(jet.value, jet.rate, force, parameters)
        mass = self.dynamics.mass(parameters) if with_mass else None
        return EquationRows.of(self.pattern, slope, mass, acceleration, self.spread)

    def mean_tangent(self, segments: Segments, point: Point) -> list[Tensor]:
        """Stiffness and damping of the terms of the linearised equations, each (T,), on the average over the times."""
        total: list[Tensor] = []
        for part in self.windows(segments):
            slope = self.dynamics.linearise(self.jet(segments, point, part), self.parameters(point))
            sums = [(x * segments.mask[part, :, None]).sum((0, 1)) for x in (slope.stiffness, slope.damping)]
            total = [before + now for before, now in zip(total, sums, strict=True)] if total else sums
        return [x / segments.mask.sum() for x in total]

    def own_by_parameter(self, segments: Segments, point: Point, part: slice = EVERY) -> Tensor:
        """(I, S, places), what each parameter does to its own connections or mass, per prior standard deviation."""
        jet = self.jet(segments, point, part)
        slope = self.dynamics.linearise(jet, self.parameters(point))
        acceleration = self.dynamics.inertial_acceleration(jet)
        return self.pattern.strength(own_by_parameter(self.dynamics.structure, slope, acceleration, self.spread))

    def moved_forces(self, point: Point, steps: Sequence[Point]) -> Iterator[tuple[slice, list[Tensor]]]:
        """Window by window which groups, and how the physics residual, as it is enforced, changes with small steps.

        Args:
            point: Where it is linearised.
            steps: Whose ``unknowns`` and ``parameters`` are changes.
        """
        for part in self.windows(self.physics):
            rows, segments = self.rows(self.physics, point, part=part), self.physics.part(part)
            averages = None if self.averages is None else self.averages.part(part)
            moved = [self._moved_force(rows, segments, step) for step in steps]
            yield part, moved if averages is None else [averages(force) for force in moved]

    def _moved_force(self, rows: EquationRows, segments: Segments, step: Point) -> Tensor:
        """(I, S, n), of some groups."""
        displacement, velocity, acceleration, _ = self._states(segments, step)
        force = rows.applied(displacement, velocity, acceleration)
        if self.vector.kinds:
            by = self.vector.placed(step.parameters)
            force = force + torch.einsum("isnkx,nkx->isn", rows.parameter, self.pattern.of_parameters(by))
        return force * self.target.equation
