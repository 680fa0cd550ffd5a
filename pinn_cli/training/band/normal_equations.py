"""Residuals of a linear-readout network, and their Gauss-Newton normal equations as a band with a border.

A residual of a DOF at one time touches the features alive there, of the DOFs that are coupled with it, and the
parameters of the connections between them. So its Jacobian is a short dense row [J | P], and all of a group's rows
together give one small dense block.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
import torch
from scipy.sparse import csr_matrix
from torch import Tensor

from pinn_cli.network.base import States
from pinn_cli.network.linear_readout import LinearReadout, Segments
from pinn_cli.network.spline import POINTS_PER_INTERVAL, SplineNetwork
from pinn_cli.physics import observation_masks, observation_residuals, physics_residual, targets
from pinn_cli.record.gauge import GAUGE
from pinn_cli.record.record import Record
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.functions import Jet
from pinn_cli.system.parameters import ParameterVector
from pinn_cli.system.quantities import CALIBRATION_UNITS
from pinn_cli.training.band.block_sums import BlockSums
from pinn_cli.training.band.bordered import BorderedSystem
from pinn_cli.training.band.dof_major import DofMajorSums
from pinn_cli.training.band.equation_rows import EquationRows, RowPattern, own_by_parameter
from pinn_cli.training.band.front_tree import FrontTree
from pinn_cli.training.band.gauge_rows import GaugeRows, calibrations
from pinn_cli.training.band.initial_motion import initial_motion
from pinn_cli.training.band.known_border import KnownBorderSystem
from pinn_cli.training.band.layout import BandLayout
from pinn_cli.training.band.point import Bounded, Point
from pinn_cli.training.band.ridge import ridge_loss, ridge_of
from pinn_cli.training.band.row_sums import RowSums
from pinn_cli.training.band.sensor_rows import SensorRows
from pinn_cli.training.band.subdomains import Subdomains
from pinn_cli.training.band.time_major import TimeMajorSums
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.whittle.whittle_estimate import KnownParameters

# Numbers of the linearised equation of motion that are held at once: little enough for the caches.
ROWS_AT_ONCE = 1_000_000


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


class NormalEquations(Bounded):
    """The weighted least-squares problem of one network, structure and record.

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
        self.observation_target = self.target.grouped_observations(self.observation.gather)
        self.physics_target = self.target.grouped_collocation(self.physics.gather)
        local = isinstance(network, SplineNetwork)
        prescribed = problem.structure.parameters | calibrations(problem.record.gauges)
        self.prescribed = {name: value.to(self.target.force) for name, value in prescribed.items()}
        self._place_parameters()
        self.pattern = RowPattern(self.dynamics, self.vector, self.target.force)
        self.layout = BandLayout(self.physics.feature, self.physics.count, self.pattern, True if local else None)
        self.grams = {name: features.mT @ features for name, (_, features) in self._own_features().items()}
        self.sensor_rows = self._sensor_rows()
        self.gauge_rows = self._gauge_rows()
        self.begins = initial_motion(network, problem, self.layout, self.target.observation_time)
        self.ridge: float | np.ndarray | None = None
        self._tree: FrontTree | None = None
        self._kept_point: Point | None = None
        self._kept_states: dict[int, States] = {}

    @cached_property
    def forces(self) -> Segments:
        """The features at the times of the force samples: those of :attr:`physics`, where every point is a sample."""
        if self.refinement == 1:
            return self.physics
        return self.network.segments(self.target.physics_time[:: self.refinement])

    def _place_parameters(self) -> None:
        like = self.target.force
        self.vector = ParameterVector(self.prescribed, self.problem.uncertain)
        self.scale = torch.as_tensor(self.vector.each("prior_std"), dtype=like.dtype, device=like.device)
        self.uncertain, self.columns = self.problem.uncertain, [np.arange(len(self.problem.uncertain))]
        # What is believed of a sensor has nothing to do with how well the structure is known.
        alone = [p.unknown or p.kind in CALIBRATION_UNITS for p in self.problem.uncertain]
        self.unknown = torch.as_tensor(alone, dtype=torch.bool, device=like.device)
        self.lower = self.vector.each("lower") / self.vector.each("prior_std")
        # 0 where a parameter is held fixed: its column then vanishes.
        self.spread = self.vector.scattered(self.scale)

    def _own_features(self) -> dict[str, tuple[Segments, Tensor]]:
        """Residuals that touch their own DOF only, with rows that never change: their segments and features."""
        masks = observation_masks(self.target, self.problem.acceleration_through)
        own = [name for name in masks if name != "observer" and self.dynamics.feels_own(name)]
        out = {name: (self.observation, getattr(self.observation, name)) for name in own}
        if self.physics.continuity is not None:
            out["continuity"] = (self.physics, self.physics.continuity)
        return out

    def _sensor_rows(self) -> dict[str, SensorRows]:
        """Residuals of sensors that feel several functions, with rows that never change."""
        masks = observation_masks(self.target, self.problem.acceleration_through)
        return {
            name: SensorRows(self.observation, self.dynamics.sensing(name), mask.cpu().numpy())
            for name, mask in masks.items()
            if name != "observer" and not self.dynamics.feels_own(name)
        }

    def _gauge_rows(self) -> list[GaugeRows]:
        """Residuals of sensors with samples and a calibration of their own."""
        return [
            GaugeRows(gauge, i, self.network, self.dynamics, self.layout, self.vector, self.target.force)
            for i, gauge in enumerate(self.problem.record.gauges)
        ]

    def gauge_residuals(self, point: Point) -> list[Tensor]:
        """Of every gauge, what it would show without noise minus what it shows, (I, S), 0 at padding."""
        parameters = self.parameters(point)
        return [rows.residual(point.unknowns, parameters) for rows in self.gauge_rows]

    def moved_gauges(self, point: Point, step: Point) -> list[Tensor]:
        """Change of what every gauge would show with a small step of weights and parameters, each (I, S)."""
        parameters = self.parameters(point)
        spread, by = self.vector.placed(self.scale), self.vector.placed(step.parameters)
        return [rows.moved(point.unknowns, parameters, step.unknowns, by, spread) for rows in self.gauge_rows]

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

    def states(self, segments: Segments, point: Point) -> States:
        """Motion at a point; kept until the point changes, since residuals, rows and losses all ask for it."""
        if point is not self._kept_point:
            self._kept_point, self._kept_states = point, {}
        if id(segments) not in self._kept_states:
            self._kept_states[id(segments)] = self._states(segments, point)
        return self._kept_states[id(segments)]

    def _states(self, segments: Segments, point: Point) -> States:
        local = self.layout.weights(point.unknowns)[segments.feature]
        continuity = None if segments.continuity is None else segments.continuity @ local
        return States(
            segments.displacement @ local, segments.velocity @ local, segments.acceleration @ local, continuity
        )

    def jet(self, segments: Segments, point: Point) -> Jet:
        """The same without what separate outputs leave between them."""
        return Jet(*self.states(segments, point)[:3])

    def flat_states(self, segments: Segments, point: Point) -> States:
        """Motion at a point in the order of the times, each (N, n)."""
        displacement, velocity, acceleration, _ = self.states(segments, point)
        return States(segments.scatter(displacement), segments.scatter(velocity), segments.scatter(acceleration), None)

    def residuals(self, point: Point) -> dict[str, Tensor]:
        """Residuals by name: ``physics``, ``continuity``, those of :func:`pinn_cli.physics.observation_masks`.

        That of the physics is one of averages (I, 1, n) where there are :attr:`averages`, the others are (I, S, n).
        """
        parameters = self.parameters(point)
        observed, states = self.states(self.observation, point), self.states(self.physics, point)
        through = self.problem.acceleration_through
        out = observation_residuals(observed, self.observation_target, self.dynamics, parameters, through)
        forces = self.force_residual(point)
        out["physics"] = forces if self.averages is None else self.averages(forces)
        if states.continuity is not None:
            out["continuity"] = states.continuity
        return out

    def force_residual(self, point: Point) -> Tensor:
        """Force that the motion takes minus the force that acts, at every collocation point, (I, S, n), N."""
        states, parameters = self.states(self.physics, point), self.parameters(point)
        return physics_residual(states, self.physics_target, self.dynamics, parameters)

    def weights(self, noise: NoiseModel) -> dict[str, Tensor]:
        """Weight of every residual under a noise model, 0 where a DOF has none: (n,), or (I, S, n) where it varies."""
        like = self.target.force
        mass = self.prescribed["m"].cpu().numpy()
        masks = observation_masks(self.target, self.problem.acceleration_through)
        out = {
            name: torch.as_tensor(noise.observation_weight(name, mass)).to(like) * mask for name, mask in masks.items()
        }
        variance = torch.as_tensor(noise.physics_variance).to(like)
        between = self.physics_target.force_between
        if between is not None:
            # The errors of neighbouring points go together: they do not average out.
            variance = variance + (between if self.averages is None else self.averages(between)).square()
        out["physics"] = self.target.equation / variance
        if self.physics.continuity is not None:
            out["continuity"] = torch.full_like(like[0], 1.0 / noise.continuity**2)
        return out

    def losses(self, point: Point, noise: NoiseModel) -> dict[str, float]:
        """Weighted sum of squares of every residual, of the parameters' prior and of the ridge.

        And ``gain``: what is most probable together with one motion is a gain that is too large, since smaller motions
        are more probable by their prior. Over all motions the density of a gain has a factor gain^-taken, with the
        values of its sensor that the motion has taken up (the determinant of the motion's Hessian).
        """
        residuals = self.residuals(point)
        weights = self.weights(noise)
        out = {name: float((weights[name] * r.square()).sum()) for name, r in residuals.items()}
        if self.gauge_rows:
            squares = [float(r.square().sum()) for r in self.gauge_residuals(point)]
            out[GAUGE] = float(np.sum(squares / noise.response[GAUGE] ** 2))
            out["gain"] = self._of_gains(point, noise)
        out["prior"] = float((self.precision(noise) * point.parameters.square()).sum())
        if self.begins is not None:
            out["initial"] = self.begins.loss(point.unknowns)
        out["ridge"] = ridge_loss(self.ridge, point.unknowns)
        return out

    def _of_gains(self, point: Point, noise: NoiseModel) -> float:
        if noise.taken_up is None:
            return 0.0
        gain = self.parameters(point)["gain"].abs().log().cpu().numpy()
        return 2.0 * sum(
            float(taken * gain[rows.number])
            for rows, taken in zip(self.gauge_rows, noise.taken_up, strict=True)
            if "gain" in rows.places
        )

    def assemble(self, point: Point, noise: NoiseModel) -> BorderedSystem:
        """Normal matrix and gradient at a point."""
        residuals, weights = self.residuals(point), self.weights(noise)
        sums, own = self._sums(), self._own_features()
        for name, residual in residuals.items():
            if name == "physics":
                for part in self.windows(self.physics):
                    rows, weight = self.rows(self.physics, point, part=part), _part(weights[name], part)
                    averages = None if self.averages is None else self.averages.part(part)
                    sums.add_rows(self.physics.part(part), rows, residual[part], weight, averages)
            elif name == "observer":
                # The observer's residual is (f - restoring force) / m - a: the rows of the restoring force over -m.
                mass = -self.parameters(point)["m"]
                for part in self.windows(self.observation):
                    rows, weight = self.rows(self.observation, point, False, part), _part(weights[name], part)
                    sums.add_rows(self.observation.part(part), rows, residual[part] * mass, weight / mass**2)
            elif name in own:
                segments, features = own[name]
                moment, weight = (self.dynamics.padded(x) for x in (features.mT @ residual, weights[name]))
                sums.add_own_rows(segments, self.grams[name], moment, weight)
            else:
                self.sensor_rows[name].add_to(sums, residual, weights[name])
        self._add_gauges(sums, point, noise)
        return self._system(sums, point, self.precision(noise))

    def _add_gauges(self, sums: RowSums, point: Point, noise: NoiseModel) -> None:
        """Add what sensors with a calibration of their own say."""
        if not self.gauge_rows:
            return
        parameters = self.parameters(point)
        spread = self.vector.placed(self.scale)
        for rows, sigma in zip(self.gauge_rows, noise.response[GAUGE], strict=True):
            rows.add_to(sums, point.unknowns, parameters, float(sigma) ** -2, spread)
            if noise.taken_up is not None and "gain" in rows.places:
                place = rows.places["gain"]
                sums.slope[place] += noise.taken_up[rows.number] * spread[place] / rows.value("gain", parameters)

    def _sums(self) -> RowSums:
        """Nothing yet: by diagonals where few features are alive at once, in dense blocks where all are."""
        features = self.physics.feature.shape[1]
        if isinstance(self.network, SplineNetwork):
            kind = TimeMajorSums if self.dynamics.structure.shapes is None else BlockSums
            return kind(self.network.channels, features, self.physics.count, self.pattern)
        return DofMajorSums(self.layout, features, self.pattern, self.target.force)

    def windows(self, segments: Segments) -> list[slice]:
        """Groups whose linearised equations of motion are held at once, one range after the other."""
        groups, samples = segments.mask.shape
        places = self.pattern.places[0].size
        size = max(1, ROWS_AT_ONCE // (samples * self.dynamics.size * (2 * len(self.pattern.offsets) + places)))
        return [slice(start, start + size) for start in range(0, groups, size)]

    def rows(self, segments: Segments, point: Point, with_mass: bool = True, part: slice = slice(None)) -> EquationRows:
        """Linearised equation of motion at a point, with or without its inertia force; in some groups alone."""
        parameters = self.parameters(point)
        jet = Jet(*(x[part] for x in self.jet(segments, point)))
        slope, acceleration = self.dynamics.linearise(jet, parameters), self.dynamics.inertial_acceleration(jet)
        if not with_mass:
            force = self.observation_target.observer_force[part]
            acceleration = self.dynamics.structure.acceleration(jet.value, jet.rate, force, parameters)
        mass = self.dynamics.mass(parameters) if with_mass else None
        return EquationRows.of(self.pattern, slope, mass, acceleration, self.spread)

    def own_by_parameter(self, segments: Segments, point: Point) -> Tensor:
        """(I, S, places), what each parameter does to its own connections or mass, per prior standard deviation."""
        jet = self.jet(segments, point)
        slope = self.dynamics.linearise(jet, self.parameters(point))
        acceleration = self.dynamics.inertial_acceleration(jet)
        return self.pattern.strength(own_by_parameter(self.dynamics.structure, slope, acceleration, self.spread))

    def moved_force(self, rows: EquationRows, step: Point) -> Tensor:
        """Change of the physics residual, as it is enforced, with a small step of weights and parameters.

        Args:
            rows: The linearised equation of motion at the collocation points.
            step: Its ``unknowns`` and ``parameters`` are changes.
        """
        displacement, velocity, acceleration, _ = self.states(self.physics, step)
        force = rows.applied(displacement, velocity, acceleration)
        if self.vector.kinds:
            by = self.vector.placed(step.parameters)
            force = force + torch.einsum("isnkx,nkx->isn", rows.parameter, self.pattern.of_parameters(by))
        force = force * self.target.equation
        return force if self.averages is None else self.averages(force)

    def precision(self, noise: NoiseModel) -> Tensor:
        """(p,), prior precision of the uncertain parameters, in their units: believed ones share one spread."""
        return torch.where(self.unknown, 1.0, noise.spread**-2)

    def _system(self, sums: RowSums, point: Point, precision: Tensor) -> BorderedSystem:
        pick, band = self.vector.column, sums.band
        if self.ridge is None:
            self.ridge = ridge_of(band.main, self.dynamics, self.layout)
        band.main[:] += self.ridge
        gradient = sums.gradient + self.ridge * point.unknowns.cpu().numpy()
        if self.begins is not None:
            self.begins.add(band, torch.from_numpy(gradient), point.unknowns.cpu())
        corner = sums.corner[np.ix_(pick, pick)] + np.diag(precision.cpu().numpy())
        slope = sums.slope[pick] + (precision * point.parameters).cpu().numpy()
        border = sums.border[:, pick]
        system = BorderedSystem(band, border, corner, gradient, slope, self._order_of_elimination(border))
        return system if self.known is None else KnownBorderSystem(**vars(system), covariance=self.known.covariance)

    def _order_of_elimination(self, border: csr_matrix) -> FrontTree | None:
        """See :class:`BorderedSystem`; worked out once for all systems whose parameters touch the same weights."""
        dissection = self.layout.dissection
        if dissection is None:
            return None
        if self._tree is None or not self._tree.suits(border):
            self._tree = FrontTree(dissection.grid, dissection.tree(), border)
        return self._tree


def _part(weight: Tensor, groups: slice) -> Tensor:
    """The weight (n,) or (I, S, n) of some groups."""
    return weight if weight.ndim == 1 else weight[groups]
