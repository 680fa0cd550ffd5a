"""A free run of an identified structure; its bands hold what is uncertain of parameters, model and measured inputs.

Structures whose parameters are drawn from what is known of them after the training.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from pinn_cli.model.knowledge import Model
from pinn_cli.record.ensemble import Members, Replay, affordable_members, distance, followed_members
from pinn_cli.record.free_run import NoFreeRunError, free_run
from pinn_cli.record.inputs import SupportErrors, input_force
from pinn_cli.record.record import Record
from pinn_cli.record.response import RESPONSE_QUANTITIES, Response
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import DivergenceError
from pinn_cli.system.parameters import MASS
from pinn_cli.system.priors import HALF_WIDTH_90
from pinn_cli.system.quantities import CALIBRATION_UNITS, FORCE, GROUND, UNITS
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import ConnectionHistories, Estimate, ParameterEstimate, Peak, RunContext
from pinn_cli.training.estimator import TrainedNetwork
from pinn_cli.training.record_scales import force_and_velocity_scale
from pinn_cli.training.sensor_samples import SensorSamples

if TYPE_CHECKING:
    from pinn_cli.scheme.predict import Predict


# A mass is not drawn below this part of its estimate.
LEAST_MASS = 0.01
INTERVAL = (5.0, 95.0)


def parameter_draws(
    parameters: Sequence[ParameterEstimate], correlation: np.ndarray | None, count: int, seed: int
) -> np.ndarray | None:
    """(count, p) draws of a Gaussian with the estimates' deviations and correlation; None where these are unknown.

    What falls below a bound is put onto it.
    """
    estimate, std = (np.array([getattr(p, name) for p in parameters]) for name in ("estimate", "std"))
    if not len(parameters):
        return np.zeros((count, 0))
    if correlation is None and len(parameters) == 1:
        correlation = np.eye(1)
    if correlation is None or not (np.isfinite(std).all() and np.isfinite(correlation).all()):
        return None
    values, vectors = np.linalg.eigh(correlation)
    root = vectors * np.sqrt(values.clip(min=0.0))
    draws = estimate + std * (np.random.default_rng([seed, 2]).standard_normal((count, len(std))) @ root.T)
    lower = np.array([p.parameter.prescribed + p.parameter.lower for p in parameters])
    return np.maximum(draws, np.where(np.isnan(lower), -np.inf, lower))


def drawn_structures(
    structure: Structure, parameters: Sequence[ParameterEstimate], draws: np.ndarray
) -> dict[str, np.ndarray]:
    """Kind to (count, members of the kind): a structure's parameters, with the draws (count, p) in their places.

    Those of sensors have no part in it.
    """
    nominal = structure.parameters_like(np.empty(0))
    drawn = {kind: np.tile(values, (len(draws), 1)) for kind, values in nominal.items()}
    for column, estimate in enumerate(parameters):
        if estimate.kind not in CALIBRATION_UNITS:
            drawn[estimate.kind][:, estimate.parameter.index] = draws[:, column]
    drawn[MASS] = np.maximum(drawn[MASS], LEAST_MASS * nominal[MASS])
    return drawn


@dataclass(frozen=True)
class Predictor(TrainedNetwork):
    """No network is trained: the structure of a finished run is simulated.

    Attributes:
        model: The finished run.
        scheme: What is asked.
    """

    model: Model
    scheme: Predict

    def check(self, problem: Problem) -> None:
        """See :meth:`Estimator.check`: any can be."""

    def solve(self, problem: JointProblem, run: RunContext) -> Estimate:
        """See :meth:`Estimator.solve`.

        Raises:
            DivergenceError: The identified structure cannot be simulated under this force.
        """
        alone = problem.alone
        structure, record = alone.structure, alone.record
        start = [*self.scheme.start, *([np.zeros(len(structure.memory))] if len(structure.memory) else [])]
        try:
            response = free_run(structure, record, start)
        except NoFreeRunError as error:
            raise DivergenceError(str(error)) from error
        parameters = []
        for p in alone.uncertain:
            reach = HALF_WIDTH_90 * p.prior_std
            parameters.append(ParameterEstimate(p, p.prescribed, p.prior_std, p.value(-reach), p.value(reach)))
        correlation = None if alone.prior is None else alone.prior.correlation
        draws = self._draws(alone, parameters, correlation, run.seed)
        state = np.tile(np.concatenate(start), (len(draws), 1))
        white, replay = _left_out(alone, self.model, response, len(draws), run.seed)
        rows = [*(white * np.eye(structure.coordinates))] if white else []
        rows += _input_noise(alone, self.model) if self.scheme.measured_input else []
        sources = np.array(rows).reshape(-1, structure.coordinates)
        levels = self.model.levels.sensors if self.scheme.measured_input else {}
        members = Members(
            drawn_structures(structure, parameters, draws), state, sources, run.seed, replay,
            SupportErrors.of(record, levels),
        )  # fmt: skip
        band = _Band(structure, record, response, members)
        displacement, velocity, acceleration = (band.std[quantity] for quantity in RESPONSE_QUANTITIES)
        std = Response(record.time, displacement, velocity, acceleration, 0.0 * response.force)
        summary = {"iterations": 0, "stop_reason": "predicted", "draws": len(draws)}
        return Estimate(
            response, std, parameters, pd.DataFrame(columns=["iteration", "seconds"]), summary, correlation,
            connections=ConnectionHistories(
                band.history["drift"], band.std["drift"], band.history["connection_force"], band.std["connection_force"]
            ),
            peaks=tuple(band.peaks()),
        )  # fmt: skip

    def _draws(
        self, problem: Problem, parameters: list[ParameterEstimate], correlation: np.ndarray | None, seed: int
    ) -> np.ndarray:
        """(draws, p), of a sampled posterior where there is one."""
        sampled, count = self.model.draws, affordable_members(problem.structure, problem.record, self.scheme.draws)
        if sampled is not None and len(sampled):
            return sampled[np.linspace(0, len(sampled) - 1, min(count, len(sampled))).round().astype(int)]
        drawn = parameter_draws(parameters, correlation, count, seed)
        return np.zeros((count, 0)) if drawn is None else drawn


class _Band:
    """What the members do about the response of the mean structure.

    Attributes:
        history, std: Name of a quantity to that of the mean structure and its deviation, (N, ...) each.
        largest: Likewise to the largest absolute values of every member, (members, ...).
    """

    def __init__(self, structure: Structure, record: Record, response: Response, members: Members) -> None:
        self.structure, self.time, drifts = structure, record.time, structure.drifts.toarray()
        motion, n = response.stretching, structure.coordinates
        e, de = (structure.elongation(x) for x in motion)
        force = structure.connection_force(e, de, z=response.hidden)
        of_connections = {"drift": motion[0] @ structure.drifts.T, "connection_force": force[:, structure.added]}
        self.history = {q: getattr(response, q) for q in RESPONSE_QUANTITIES} | of_connections
        self.std = {name: np.full(x.shape, np.nan) for name, x in self.history.items()}
        self.largest = {name: np.zeros((len(members.start), x.shape[1])) for name, x in self.history.items()}
        parameters = members.with_parameters_of(structure)
        with np.errstate(over="ignore", invalid="ignore"):
            for part, moved, states, carried in followed_members(members, structure, record, response.state(0)):
                u, v = (np.concatenate((states[..., k * n : (k + 1) * n], carried[..., k, :]), -1) for k in range(2))
                e, de = structure.elongation(u), structure.elongation(v)
                force = structure.connection_force(e, de, parameters, states[..., 2 * n :])
                histories = moved | {"drift": u @ drifts.T, "connection_force": force[..., structure.added]}
                for name, values in histories.items():
                    np.maximum(self.largest[name], np.abs(values[:, :-1]).max(axis=0), out=self.largest[name])
                    self.std[name][part] = distance(values)

    def peaks(self) -> list[Peak]:
        """Of every history that is known to its end."""
        peaks, structure = [], self.structure
        connections = [structure.labels.connection(i) for i in structure.added.tolist()]
        names = {"drift": structure.drift_names, "connection_force": connections}
        units = {**UNITS, "drift": "m", "connection_force": "N"}
        for name, largest in self.largest.items():
            if not np.isfinite(self.std[name]).all() or not np.isfinite(largest).all():
                continue
            lower, upper = np.percentile(largest, INTERVAL, axis=0)
            for i, sample in enumerate(np.abs(self.history[name]).argmax(axis=0)):
                of = names[name][i] if name in names else structure.dof_name(i)
                peak, time = abs(float(self.history[name][sample, i])), float(self.time[sample])
                peaks.append(Peak(name, of, units[name], peak, time, float(lower[i]), float(upper[i])))
        return peaks


def _left_out(problem: Problem, model: Model, response: Response, count: int, seed: int) -> tuple[float, Replay | None]:
    """What the model leaves out: a white force on every coordinate, N per sample, and one that acted on the record.

    Both are as large a part of the inputs as they were. A white one has the same power at every frequency, at any rate.
    """
    record, levels, misfit = problem.record, model.levels, model.misfit
    finer = float(np.sqrt(levels.step / record.step))
    if misfit is not None:
        acting = float(np.sqrt(np.mean(input_force(problem.structure, record) ** 2)))
        part = acting / misfit.acting if misfit.acting > 0.0 else 1.0
        replay = Replay.drawn(part * misfit.history.astype(float), record.step / misfit.step, count, seed)
        return part * finer * misfit.rest, replay
    if not (np.isfinite(levels.discrepancy) and levels.force > 0.0):
        return 0.0, None
    moved = replace(record, acceleration=response.acceleration, responds=True)  # what a moving ground comes to
    force, _ = force_and_velocity_scale(replace(problem, record=moved))
    return levels.discrepancy * force / levels.force * finer, None


def _input_noise(problem: Problem, model: Model) -> list[np.ndarray]:
    """A row (n,) for the noise of every measured input: what its spectrum shows, else what the run found."""
    structure, record, levels = problem.structure, problem.record, model.levels
    shapes = structure.shapes.matrix
    nothing = np.full(record.ndof, np.nan)
    loaded = np.flatnonzero(~record.unforced)
    inputs = [(shapes[dof], FORCE, int(dof)) for dof in loaded]
    if record.ground_acceleration is not None:
        inputs.append((structure.parameters_like(np.empty(0))[MASS] * structure.with_ground, GROUND, 0))
    noise = []
    for column, quantity, channel in inputs:
        sensor, sigmas = SensorSamples(record.column(quantity, channel), record), levels.sensors.get(quantity, nothing)
        # White noise is nowhere less than in the emptiest part of a spectrum: an input that was computed has none.
        sigma = sensor.shown or np.minimum(sigmas[channel], sensor.most)
        noise += [sigma * column] if np.isfinite(sigma) else []
    return noise
