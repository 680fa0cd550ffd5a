"""What all factors of one record share: features at its times, the order of the unknowns, and the motion at a point.

What is as long as the record is held for a window alone, wherever a sum over windows is asked for: memory then grows
with the unknowns, and arrays stay so small that the system need not clear new pages for each.
"""

from __future__ import annotations

import math
from functools import cached_property

import torch
from torch import Tensor

from pinn_cli.network.linear_readout import LinearReadout, Segments, in_groups
from pinn_cli.network.network import States
from pinn_cli.network.spline import POINTS_PER_INTERVAL, SplineNetwork
from pinn_cli.physics import targets
from pinn_cli.record.record import Record
from pinn_cli.scheme.calibration import calibrations
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.functions import Jet
from pinn_cli.system.parameters import ParameterVector
from pinn_cli.system.quantities import OUTSIDE_THE_EQUATIONS
from pinn_cli.training.beginning import Beginning
from pinn_cli.training.minimise import Point
from pinn_cli.training.normal_matrix.layout import BandLayout
from pinn_cli.training.normal_matrix.row_pattern import RowPattern
from pinn_cli.training.subdomains import Subdomains

# Numbers of the linearised equation of motion that are held at once: little enough for the caches.
ROWS_AT_ONCE = 1_000_000
# Numbers of a motion up to which all its windows are kept until the point changes; of a longer one the last is.
KEPT_NUMBERS = 4_000_000
# Covariances that are taken from the inverse at once, at least.
FEWEST_COVARIANCES = 64
EVERY = slice(None)


def collocation_refinement(network: LinearReadout, record: Record) -> int:
    """Collocation points for every sample, so that each knot interval has its own.

    A force that is held has one value for every step and no others.
    """
    if record.intersample != "band_limited" or not isinstance(network, SplineNetwork):
        return 1
    return max(1, math.ceil(POINTS_PER_INTERVAL * record.step / network.spacing - 1e-6))


class Frame:
    """A network, a structure and a record.

    Histories are grouped as the network's segments are, (I, S, n), and 0 at padding.

    Args:
        network: Fixed features, linear readout, an output for every unknown function.
        problem: Structure, record, uncertain parameters.

    Attributes:
        target: What the residuals compare with.
        observation, physics: Features at the record's samples, and where the equations hold.
        averages: Of the equations over the knot intervals; None: they hold at every point.
        beginning: Where the motion goes on from an earlier record; None: it does not.
        prescribed: Kind to all its members where none has moved.
        uncertain: The parameters, p of them.
        vector: The same, as a vector.
        scale: (p,), prior standard deviations.
        spread: Kind to those of all its members, 0 where one is held fixed: its column then vanishes.
        spread_by_place: The same of all members, one kind after the other.
        unknown: (p,) bool: what shares no spread with the others.
        lower: (p,), bounds in prior standard deviations from the prescribed values.
    """

    def __init__(self, network: LinearReadout, problem: Problem) -> None:
        self.problem, self.dynamics, self.is_plain = problem, problem.dynamics, problem.dynamics.is_plain
        self.refinement = collocation_refinement(network, problem.record)
        self.target = targets(problem.record, self.dynamics, refinement=self.refinement)
        self.network = network
        self.observation = network.segments(self.target.observation_time)
        self.physics = network.segments(self.target.physics_time)
        self.averages: Subdomains | None = None
        if isinstance(network, SplineNetwork) and network.channels == 1 and network.degree % 2 == 0:
            self.averages = Subdomains(self.physics)
            self.physics, turns = self.averages.segments, problem.turning_points
            if turns is not None:
                near = turns.near(self.averages.times(self.target.physics_time), network.spacing)
                self.averages = self.averages.loosened(torch.as_tensor(near), turns.looser)
        self.beginning = Beginning.of(problem)
        prescribed = problem.structure.parameters | calibrations(problem.record.calibrated)
        prescribed |= {} if self.beginning is None else self.beginning.prescribed
        self.prescribed = {name: value.to(self.target.force) for name, value in prescribed.items()}
        self._place_parameters()
        self.pattern = RowPattern(self.dynamics, self.vector, self.target.force)
        self.layout = BandLayout(self.physics.feature, self.physics.count, self.pattern)
        self._kept_point: Point | None = None
        self._kept_states: dict[tuple[int, int | None, int | None], States] = {}

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
        self.spread, self.spread_by_place = self.vector.scattered(self.scale), self.vector.placed(self.scale)

    def readout(self, point: Point) -> Tensor:
        """The readout weights of a point as the network keeps them, (channels, count, ndof)."""
        return self.layout.weights(point.unknowns).unflatten(0, (-1, self.network.channels)).movedim(1, 0).contiguous()

    def parameters(self, point: Point) -> dict[str, Tensor]:
        """Every parameter of the structure by kind at a point."""
        return self.vector.values(self.scale * point.parameters)

    def windows(self, segments: Segments, width: int = 0) -> list[slice]:
        """Groups whose linearised equations of motion are held at once, one range after the other.

        With a width each group needs a covariance of that width besides.
        """
        groups, samples = segments.mask.shape
        places = self.pattern.places[0].size
        size = max(1, ROWS_AT_ONCE // (samples * self.dynamics.size * (2 * len(self.pattern.offsets) + places)))
        size = min(size, max(FEWEST_COVARIANCES, ROWS_AT_ONCE // width**2)) if width else size
        return [slice(start, min(start + size, groups)) for start in range(0, groups, size)]

    def averaged(self, values: Tensor, part: slice = EVERY) -> Tensor:
        """Histories (I, ..., S, C) of some groups as the equations hold: averages (I, ..., 1, C), or as they are."""
        return values if self.averages is None else self.averages(values, part)

    def states(self, segments: Segments, point: Point, part: slice = EVERY) -> States:
        """Motion at a point, of some groups; residuals, rows and losses all ask for it."""
        if point is not self._kept_point:
            self._kept_point, self._kept_states = point, {}
        key = id(segments), part.start, part.stop
        if key not in self._kept_states:
            if segments.mask.numel() * self.dynamics.size > KEPT_NUMBERS:
                self._kept_states = {}
            self._kept_states[key] = self.fresh_states(segments.part(part), point)
        return self._kept_states[key]

    def fresh_states(self, segments: Segments, point: Point) -> States:
        """The same, and not kept."""
        local = self.layout.weights(point.unknowns)[segments.feature]
        continuity = None if segments.continuity is None else in_groups(segments.continuity, local)
        # One product for all three: of few features in many groups what counts is how many products there are.
        motion = in_groups(segments.jet.flatten(1, 2), local).unflatten(1, segments.jet.shape[1:3])
        displacement, velocity, acceleration = motion.unbind(1)
        return States(displacement, velocity, acceleration, continuity)

    def jet(self, segments: Segments, point: Point, part: slice = EVERY) -> Jet:
        """The same without what separate outputs leave between them."""
        return Jet(*self.states(segments, point, part)[:3])

    def flat_states(self, segments: Segments, point: Point) -> States:
        """Motion at a point in the order of the times, each (N, n)."""
        shape = segments.samples, self.dynamics.size
        displacement, velocity, acceleration = flat = [point.unknowns.new_zeros(shape) for _ in range(3)]
        for part in self.windows(segments):
            group = segments.part(part)
            for out, values in zip(flat, self.fresh_states(group, point)[:3], strict=True):
                group.place(values, out)
        return States(displacement, velocity, acceleration, None)
