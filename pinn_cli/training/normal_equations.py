"""The Gauss-Newton normal equations of one record, added up over its factors, as a band with a border.

A residual of a DOF at one time touches the features alive there, of the DOFs that are coupled with it, and the
parameters of the connections between them. So its Jacobian is a short dense row [J | P], and all of a group's rows
together give one small dense block.

Accelerometers through the observer equation, (f - restoring force) / m (paper, eq. 8).

What separate outputs of displacement and velocity leave between them, d(displacement)/dt - velocity (eq. 10b).
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence

import numpy as np
import torch
from scipy.sparse import csr_matrix, identity
from torch import Tensor

from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.physics import observation_masks
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.quantities import FORCE, GROUND, SUPPORT
from pinn_cli.training.factors.calibrated_channels import CalibratedChannels, Gains, SensorFilter
from pinn_cli.training.factors.constant_channels import ConstantRows, ResponseChannels
from pinn_cli.training.factors.equation_rows import EquationRows, EquationsOfMotion
from pinn_cli.training.factors.factor import Channels, Factor, Residuals
from pinn_cli.training.factors.frame import Frame
from pinn_cli.training.factors.input_channels import InputChannels
from pinn_cli.training.factors.known_state import states_known
from pinn_cli.training.factors.ridge import Ridge
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_matrix.bordered import BorderedSystem, order_of_elimination
from pinn_cli.training.normal_matrix.elimination import Order
from pinn_cli.training.normal_matrix.row_sums import RowSums
from pinn_cli.training.whittle.whittle_estimate import KnownParameters


class Observer(Residuals):
    """What they measure against what the equation of motion says of it.

    Args:
        frame: Of the record.
        mask: (n,) bool, the DOFs whose accelerometer is compared so.
    """

    name = "observer"

    def __init__(self, frame: Frame, mask: Tensor) -> None:
        super().__init__(frame)
        self.mask, self.segments = mask, frame.observation
        gather = self.segments.gather
        self.force, self.measured = gather(frame.target.observer_force), gather(frame.target.response["acceleration"])

    def _acceleration(self, point: Point, part: slice) -> Tensor:
        jet = self.frame.jet(self.segments, point, part)
        structure = self.frame.dynamics.structure
        return structure.acceleration(jet.value, jet.rate, self.force[part], self.frame.parameters(point))

    def residual(self, point: Point, part: slice) -> Tensor:
        """See :meth:`Residuals.residual`."""
        return (self._acceleration(point, part) - self.measured[part]) * self.mask

    def weight(self, noise: NoiseModel) -> Tensor:
        """(n,): the force's noise and the discrepancy are in the residual as well."""
        mass = self.frame.prescribed["m"].cpu().numpy()
        return torch.as_tensor(noise.observer_weight(mass)).to(self.measured) * self.mask

    def add_to(self, sums: RowSums, point: Point, noise: NoiseModel) -> None:
        """See :meth:`Factor.add_to`."""
        # The rows of the restoring force over -m.
        frame, weight, mass = self.frame, self.weight(noise), -self.frame.parameters(point)["m"]
        for part, residual in self.residuals(point):
            slope = frame.dynamics.linearise(frame.jet(self.segments, point, part), frame.parameters(point))
            acceleration = self._acceleration(point, part)
            rows = EquationRows.of(frame.pattern, slope, None, acceleration, frame.spread)
            rows.add_to(sums, self.segments.part(part), residual * mass, weight / mass**2)


class Continuity(Residuals):
    """Of every function, at the collocation points."""

    name = "continuity"

    def __init__(self, frame: Frame) -> None:
        super().__init__(frame)
        self.segments = frame.physics
        assert self.segments.continuity is not None
        self.rows = ConstantRows(
            self.segments, [(self.segments.continuity, identity(frame.dynamics.size, format="csr"))]
        )

    def residual(self, point: Point, part: slice) -> Tensor:
        """See :meth:`Residuals.residual`."""
        continuity = self.frame.states(self.segments, point, part).continuity
        assert continuity is not None
        return continuity

    def weight(self, noise: NoiseModel) -> Tensor:
        """See :meth:`Residuals.weight`."""
        return torch.full_like(self.frame.target.force[0], noise.continuity**-2)

    def add_to(self, sums: RowSums, point: Point, noise: NoiseModel) -> None:
        """See :meth:`Factor.add_to`."""
        weight = self.weight(noise)
        for part, residual in self.residuals(point):
            self.rows.add_to(sums, residual, weight, part)


class NormalEquations(Frame):
    """The weighted least-squares problem of one network, structure and record.

    Args:
        network: Fixed features, linear readout, an output for every unknown function.
        problem: Structure, record, uncertain parameters.
        known_parameters: Parameters of a linear structure that something else determines; None: they are solved for.

    Attributes:
        factors: All that is said of the record's unknowns but what is believed of the parameters.
        channels: Those of sensors.
        motion: The equations of motion.
        observer: Accelerometers through these; None: through the motion's derivative alone.
        ridge: The prior of the readout weights.
        pull: (p,), a constant force on the parameters, see :mod:`pinn_cli.training.steps.marginal_peak`; None: there is
            none.
    """

    def __init__(
        self,
        network: LinearReadout,
        problem: Problem,
        known_parameters: KnownParameters | None = None,
    ) -> None:
        super().__init__(network, problem)
        self.known_parameters, self.is_linear = known_parameters, known_parameters is not None
        masks = observation_masks(self.target, problem.acceleration_through)
        self.observer = Observer(self, masks.pop("observer")) if "observer" in masks else None
        self.channels: list[Channels] = [
            (InputChannels if quantity in (GROUND, FORCE, *SUPPORT) else ResponseChannels)(self, quantity, mask)
            for quantity, mask in masks.items()
        ]
        calibrated = CalibratedChannels(self)
        self.channels += [calibrated] if calibrated.channels else []
        self.motion, self.ridge = EquationsOfMotion(self), Ridge(self)
        self.factors: list[Factor] = [
            *self.channels,
            *([] if self.observer is None else [self.observer]),
            self.motion,
            *([] if self.physics.continuity is None else [Continuity(self)]),
            *([Gains(self, calibrated.channels)] if calibrated.channels else []),
            *(
                SensorFilter(self, channel, channel.state)
                for channel in calibrated.channels
                if channel.state is not None
            ),
            self.ridge,
            *states_known(self),
        ]
        self.pull: np.ndarray | None = None
        self.pulled_from = torch.zeros_like(self.scale)
        self._order: Order | None = None

    def start(self) -> Point:
        """The structure at rest with its prescribed parameters, or with those that are known."""
        zeros = self.target.force.new_zeros
        parameters = (
            zeros(len(self.scale)) if self.known_parameters is None else torch.as_tensor(self.known_parameters.distance)
        )
        return Point(zeros(self.layout.size), parameters.to(self.target.force))

    def losses(self, point: Point, noise: NoiseModel, prior: np.ndarray | None = None) -> dict[str, float]:
        """Weighted sum of squares of every kind of factor, and of the parameters' prior.

        Args:
            point: Where.
            noise: The weights.
            prior: (p, p), precision of what is believed of the parameters; None: nothing is.
        """
        out: defaultdict[str, float] = defaultdict(float)
        for factor in self.factors:
            out[factor.name] += factor.loss(point, noise)
        if prior is not None:
            out["prior"] = float((point.parameters * (torch.as_tensor(prior).to(self.scale) @ point.parameters)).sum())
        if self.pull is not None:
            moved = point.parameters - self.pulled_from
            out["marginal"] = -2.0 * float(self.pull @ moved.cpu().numpy())
        return dict(out)

    def assemble(self, point: Point, noise: NoiseModel, prior: np.ndarray | None = None) -> BorderedSystem:
        """Normal matrix and gradient at a point; arguments as of :meth:`losses`."""
        sums, pick = self._added(self.factors, point, noise), self.vector.column
        border, corner, slope = sums.border(pick), sums.corner[np.ix_(pick, pick)], sums.slope[pick]
        if prior is not None:
            corner = corner + prior
            slope = slope + (torch.as_tensor(prior).to(self.scale) @ point.parameters).cpu().numpy()
        slope = slope if self.pull is None else slope - self.pull
        if self._order is None or not self._order.suits(border):  # the same parameters mostly touch the same weights
            self._order = order_of_elimination(self.layout.dissection, border)
        return BorderedSystem(sums.band, border, corner, sums.gradient, slope, self._order)

    def log_determinants(self, point: Point, levels: Sequence[NoiseModel]) -> list[float]:
        """Of the readout weights' normal matrix under levels that weigh the equations alike; NaN: not definite."""
        none, found = csr_matrix((self.layout.size, 0)), []
        order = (self._order or order_of_elimination(self.layout.dissection, none)).alone
        shared = self._added([self.motion], point, levels[0]).band
        others = [factor for factor in self.factors if factor is not self.motion]
        for noise in levels:
            readout = order.eliminated(shared + self._added(others, point, noise).band, none)
            found.append(math.nan if readout is None else readout.log_determinant)
        return found

    def _added(self, factors: Sequence[Factor], point: Point, noise: NoiseModel) -> RowSums:
        alive, count = self.physics.feature.shape[1], self.physics.count
        sums = RowSums(self.network.channels, alive, count, self.dynamics.coupling, self.pattern.count)
        for factor in factors:
            factor.add_to(sums, point, noise)
        return sums

    @property
    def joint_precision(self) -> np.ndarray | None:
        """(p, p), of what earlier records say of the parameters together, in their units; None where there are none."""
        if self.beginning is not None:
            return self.beginning.precision
        return None if self.problem.prior is None else self.problem.prior.precision
