"""The Gauss-Newton normal equations of a linear-readout network as a band with a border.

A residual of a DOF at one time touches the features alive there, of the DOFs that are coupled with it, and the
parameters of the connections between them. So its Jacobian is a short dense row [J | P], and all of a group's rows
together give one small dense block.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from scipy.sparse import csr_matrix, identity
from torch import Tensor

from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.physics import observation_masks
from pinn_cli.record.gauge import GAUGE
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.band.bordered import BorderedSystem
from pinn_cli.training.band.filter_rows import FilterRows
from pinn_cli.training.band.front_tree import FrontTree
from pinn_cli.training.band.initial_motion import states_known
from pinn_cli.training.band.point import Point
from pinn_cli.training.band.residuals import Residuals
from pinn_cli.training.band.ridge import ridge_loss, ridge_of
from pinn_cli.training.band.row_sums import RowSums
from pinn_cli.training.band.sensor_rows import SensorRows
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.whittle.whittle_estimate import KnownParameters


class NormalEquations(Residuals):
    """The weighted least-squares problem of one network, structure and record; arguments as of :class:`Residuals`.

    Attributes:
        pull: (p,), a constant force on the parameters, see :mod:`pinn_cli.training.band.marginal_peak`; None: there is
            none.
    """

    def __init__(
        self,
        network: LinearReadout,
        problem: Problem,
        device: str = "cpu",
        known: KnownParameters | None = None,
    ) -> None:
        super().__init__(network, problem, device, known)
        self.sensor_rows = self._sensor_rows()
        self.filter_rows = [
            FilterRows(rows, self.physics, self.averages) for rows in self.gauge_rows if rows.state is not None
        ]
        self.states_known = states_known(network, problem, self.layout, self.target.observation_time, self.beginning)
        self.ridge: float | np.ndarray | None = None
        self.pull: np.ndarray | None = None
        self._tree: FrontTree | None = None

    def _sensor_rows(self) -> dict[str, SensorRows]:
        """Residuals with rows that never change: those of sensors, and what separate outputs leave between them."""
        segments, masks = self.observation, observation_masks(self.target, self.problem.acceleration_through)
        jet = segments.displacement, segments.velocity, segments.acceleration
        out = {
            name: SensorRows(segments, [(jet[order], felt) for order, felt in self.dynamics.sensing(name)])
            for name in masks
            if name != "observer" and name not in self.inputs
        }
        out |= {name: rows.rows for name, rows in self.inputs.items() if name in masks}
        if self.physics.continuity is not None:
            every = identity(self.dynamics.size, format="csr")
            out["continuity"] = SensorRows(self.physics, [(self.physics.continuity, every)])
        return out

    def weights(self, noise: NoiseModel) -> dict[str, Tensor]:
        """Weight of every residual under a noise model, 0 where a DOF has none: (n,), or (I, S, n) where it varies."""
        like = self.target.force
        mass = self.prescribed["m"].cpu().numpy()
        masks = observation_masks(self.target, self.problem.acceleration_through)
        out = {
            name: torch.as_tensor(noise.observation_weight(name, mass)).to(like) * mask for name, mask in masks.items()
        }
        out |= {name: out[name] / rows.refinement for name, rows in self.inputs.items()}
        variance = torch.as_tensor(noise.physics_variance).to(like)
        between = self.physics_target.force_between
        if between is not None:
            # The errors of neighbouring points go together: they do not average out.
            variance = variance + (between if self.averages is None else self.averages(between)).square()
        out["physics"] = self.target.equation / variance
        if self.physics.continuity is not None:
            out["continuity"] = torch.full_like(like[0], 1.0 / noise.continuity**2)
        return out

    def losses(self, point: Point, noise: NoiseModel, prior: np.ndarray | None = None) -> dict[str, float]:
        """Weighted sum of squares of every residual, of the parameters' prior and of the ridge.

        And ``gain``: what is most probable together with one motion is a gain that is too large, since smaller motions
        are more probable by their prior. Over all motions the density of a gain has a factor gain^-taken, with the
        values of its sensor that the motion has taken up (the determinant of the motion's Hessian).

        Args:
            point: Where.
            noise: The weights.
            prior: (p, p), precision of what is believed of the parameters; None: nothing is.
        """
        weights = self.weights(noise)
        out = {name: float((weights[name] * square).sum()) for name, square in self.squares(point).items()}
        out["physics"] = float((weights["physics"] * self.physics_residual(point).square()).sum())
        if self.gauge_rows:
            out[GAUGE] = self._of_gauges(point, noise)
            out["gain"] = self._of_gains(point, noise)
        if self.filter_rows:
            parameters = self.parameters(point)
            left = ((f.weight, f.residual(point.unknowns, parameters)) for f in self.filter_rows)
            out["filter"] = float(sum(weight * residual.square().sum() for weight, residual in left))
        if prior is not None:
            out["prior"] = float((point.parameters * (torch.as_tensor(prior).to(self.scale) @ point.parameters)).sum())
        if self.pull is not None:
            out["marginal"] = -2.0 * float(self.pull @ point.parameters.cpu().numpy())
        if self.states_known:
            out["initial"] = sum(rows.loss(point.unknowns, point.parameters) for rows in self.states_known)
        out["ridge"] = ridge_loss(self.ridge, point.unknowns)
        return out

    def _of_gauges(self, point: Point, noise: NoiseModel) -> float:
        """Infinite where a delay is out of the record's reach."""
        parameters = self.parameters(point)
        if not all(rows.reaches(parameters) for rows in self.gauge_rows):
            return math.inf
        squares = [float(r.square().sum()) for r in self.gauge_residuals(point)]
        return float(np.sum(squares / noise.response[GAUGE] ** 2))

    def _of_gains(self, point: Point, noise: NoiseModel) -> float:
        if noise.taken_up is None:
            return 0.0
        gain = self.parameters(point)["gain"].abs().log().cpu().numpy()
        return 2.0 * sum(
            float(taken * gain[rows.number])
            for rows, taken in zip(self.gauge_rows, noise.taken_up, strict=True)
            if "gain" in rows.places
        )

    def assemble(self, point: Point, noise: NoiseModel, prior: np.ndarray | None = None) -> BorderedSystem:
        """Normal matrix and gradient at a point; arguments as of :meth:`losses`."""
        weights, alive = self.weights(noise), self.physics.feature.shape[1]
        sums = RowSums(self.network.channels, alive, self.physics.count, self.dynamics.coupling, self.pattern.count)
        for part, residuals in self.in_windows(point):
            for name, residual in residuals.items():
                self._add(sums, name, residual, weights[name], point, part)
        self._add_gauges(sums, point, noise)
        return self._system(sums, point, prior)

    def _add(self, sums: RowSums, name: str, residual: Tensor, weight: Tensor, point: Point, part: slice) -> None:
        """Add the rows of one residual in some groups; the weight is (n,), or (I, S, n) of all groups."""
        weight = weight if weight.ndim == 1 else weight[part]
        if name == "physics":
            averages = None if self.averages is None else self.averages.part(part)
            rows = self.rows(self.physics, point, part=part)
            for each in rows.weighted(self.physics.part(part), residual, weight, averages):
                sums.add(each)
        elif name == "observer":
            # The observer's residual is (f - restoring force) / m - a: the rows of the restoring force over -m.
            mass = -self.parameters(point)["m"]
            rows = self.rows(self.observation, point, False, part)
            for each in rows.weighted(self.observation.part(part), residual * mass, weight / mass**2):
                sums.add(each)
        else:
            self.sensor_rows[name].add_to(sums, residual, weight, part)

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

        for filter_rows in self.filter_rows:
            filter_rows.add_to(sums, point.unknowns, parameters, spread)

    @property
    def joint_precision(self) -> np.ndarray | None:
        """(p, p), of what earlier records say of the parameters together, in their units; None where there are none."""
        if self.beginning is not None:
            return self.beginning.precision
        return None if self.problem.prior is None else self.problem.prior.precision

    def _system(self, sums: RowSums, point: Point, prior: np.ndarray | None) -> BorderedSystem:
        pick = self.vector.column
        if self.ridge is None:
            self.ridge = ridge_of(sums.main, self.dynamics, self.layout)
        for rows in self.states_known:
            rows.add_to(sums, point, pick)
        band, border = sums.band, sums.border(pick)
        band.main[:] += self.ridge
        gradient = sums.gradient + self.ridge * point.unknowns.cpu().numpy()
        corner, slope = sums.corner[np.ix_(pick, pick)], sums.slope[pick]
        if prior is not None:
            corner = corner + prior
            slope = slope + (torch.as_tensor(prior).to(self.scale) @ point.parameters).cpu().numpy()
        slope = slope if self.pull is None else slope - self.pull
        return BorderedSystem(band, border, corner, gradient, slope, self._order_of_elimination(border))

    def _order_of_elimination(self, border: csr_matrix) -> FrontTree:
        """See :class:`BorderedSystem`; worked out once for all systems whose parameters touch the same weights."""
        if self._tree is None or not self._tree.suits(border):
            dissection = self.layout.dissection
            self._tree = FrontTree(dissection.grid, dissection.tree(), border)
        return self._tree
