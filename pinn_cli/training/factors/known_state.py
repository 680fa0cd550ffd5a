"""What a linear readout's normal equations gain where something is known of the motion at an end of the record.

How it begins may be known: at rest, at an earlier record's end. And no mode moves at either end as it never does in
between. Modes above the record's band, which no sensor tells, otherwise balance each other there, in the physics'
equations and at the sensors, however large they are.

How fast modes move is what the motion of the record's sensors implies for all of them, also for those that none sees.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from pinn_cli.record.channels import motion_amplitudes, record_band
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.scheme.problem import RESIDUAL_MOTION, Problem
from pinn_cli.system.parameters import MASS
from pinn_cli.training.beginning import TIE, Beginning
from pinn_cli.training.factors.factor import Factor
from pinn_cli.training.factors.frame import Frame
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_matrix.row_sums import Rows, RowSums, Touched
from pinn_cli.training.record_scales import force_and_velocity_scale, newtons

# Standard deviations of a mode's motion, over what a force that acts on all modes alike would make it.
MODE_WIDTH = 3.0
# Damping ratio of modes at least, and frequencies at which their response is summed up.
LEAST_DAMPING, FREQUENCIES = 0.02, 4096


def modal_deviation(problem: Problem) -> np.ndarray | None:
    """(n, 2), standard deviations of the velocity and the acceleration of every coordinate at any time.

    A random force, flat over the record's band and as large on every mode, whose response is as large as that of the
    sensors: in the band modes resonate, above it they follow slowly, and no more. None where coordinates are no modes.
    """
    structure, record = problem.structure, problem.record
    if not structure.is_modal:
        return None
    n = structure.coordinates
    p = structure.parameters_like(np.empty(0))
    m = p[MASS]
    omega = np.sqrt(np.maximum(p["k"][:n] / m, 0.0))
    damping = np.maximum(p["c"][:n] / m, 2.0 * LEAST_DAMPING * omega)
    band = 2.0 * np.pi * record_band(record)
    w = np.geomspace(min(2.0 * np.pi / record.duration, 0.5 * band), band, FREQUENCIES)
    power = m[:, None] ** -2.0 / ((omega[:, None] ** 2 - w**2) ** 2 + (damping[:, None] * w) ** 2)
    velocity, acceleration = (np.trapezoid(power * w**order, w) / band for order in (2, 4))
    of_dofs = structure.shapes.matrix**2 @ acceleration
    seen = any(record.sensors(quantity).any() for quantity in RESPONSE_QUANTITIES)
    level = force_and_velocity_scale(problem)[0]
    if seen:
        level = motion_amplitudes(record)["acceleration"] / float(np.sqrt(of_dofs.mean()))
    deviation: np.ndarray = MODE_WIDTH * level * np.sqrt(np.stack((velocity, acceleration), axis=1))
    return deviation


# Prior standard deviation of an unknown force at the first sample, over the force that the record is about.
FIRST_FORCE = 3.0


class State(NamedTuple):
    """Two derivatives of every function at one sample, one after the other: values and rates, or rates and curvatures.

    Attributes:
        order: Of the first of them, 0 or 1.
        deviation: (functions, 2), their standard deviations; infinite where nothing is known.
        column: (functions, 2), which of the uncertain numbers each is, -1 where it is 0.
        value: (p,), of the uncertain numbers what they are where none has moved.
        unit: (p,), what one of them moves by.
    """

    order: int
    deviation: np.ndarray
    column: np.ndarray
    value: np.ndarray
    unit: np.ndarray

    @classmethod
    def about_zero(cls, order: int, deviation: np.ndarray) -> State:
        """With no number uncertain."""
        return cls(order, deviation, np.full(deviation.shape, -1), np.zeros(0), np.zeros(0))


class KnownState(Factor):
    """What is known of the functions at one sample, over standard deviations.

    Two residuals per function, linear in the readout: J w - x with J (F, 2, B) over the B features alive there. All of
    it is on the CPU, where the solver is.

    Args:
        frame: Of the record.
        state: What is known.
        time: (1,), s, of the sample.
    """

    name = "initial"

    def __init__(self, frame: Frame, state: State, time: Tensor) -> None:
        super().__init__(frame)
        segments = frame.network.segments(time)
        alive = segments.mask[:, 0] > 0
        self.feature = segments.feature[alive][:1]
        jet = segments.orders
        rows = torch.stack([x[alive][0, 0] for x in jet[state.order : state.order + 2]])
        self.jacobian = rows / rows.new_tensor(state.deviation)[:, :, None]
        place = frame.layout.positions(self.feature.numpy(), np.arange(len(state.deviation))[:, None])  # (F, B)
        self.place = torch.as_tensor(place)
        # Of the uncertain numbers: which residual has each, where that stands, and how large it is there.
        self.of, self.rate = np.nonzero(state.column >= 0)
        self.column, self.number = state.column, state.column[self.of, self.rate]
        over = state.deviation[self.of, self.rate]
        self.value, self.unit = (rows.new_tensor(x[self.number] / over) for x in (state.value, state.unit))

    def loss(self, point: Point, noise: NoiseModel) -> float:
        """See :meth:`Factor.loss`."""
        return float(self.residuals(point).square().sum())

    def add_to(self, sums: RowSums, point: Point, noise: NoiseModel) -> None:
        """See :meth:`Factor.add_to`."""
        order = self.frame.layout.pattern.order
        by = np.zeros((3, 2, len(order)))  # both numbers of a function and the residual, by the value and the rate
        by[self.rate, self.rate, self.of] = -self.unit.numpy()
        by[-1] = self.residuals(point).numpy().T
        places = np.where(self.column >= 0, np.append(self.frame.vector.column, -1)[self.column], -1)
        touched = Touched(0, 0, self.jacobian.permute(2, 1, 0).numpy()[None, :, :, None, order])
        sums.add(Rows(self.feature, [touched], places[order].T, by[:, :, None, order]))

    def residuals(self, point: Point) -> Tensor:
        """(F, 2)."""
        unknowns, numbers = point.unknowns, point.parameters
        out = torch.einsum("frb,fb->fr", self.jacobian, unknowns[self.place])
        if len(self.number):
            out[self.of, self.rate] -= self.value + self.unit * numbers[self.number]
        return out


def states_known(frame: Frame) -> list[KnownState]:
    """At the first sample and at the last one; none where both are anyhow."""
    problem, beginning, time = frame.problem, frame.beginning, frame.target.observation_time
    first, last = time[:1], time[-1:]
    states = [(_first(problem, beginning), first)]
    size = modal_deviation(problem)
    if size is not None:
        std = np.full((problem.dynamics.size, 2), np.inf)
        std[: problem.dynamics.ndof] = size
        of_modes = State.about_zero(1, std)
        states += [(of_modes, last)] if beginning is not None else [(of_modes, first), (of_modes, last)]
    return [KnownState(frame, state, at) for state, at in states if state is not None]


def _first(problem: Problem, beginning: Beginning | None) -> State | None:
    """Where motion begins at rest or at a known state, or with what is counted from there, or with unknown forces.

    None where all begins anyhow.

    A process that white noise drives begins somewhere, too: without a word on that, a force that nobody measured and
    the motion of a DOF without a sensor balance each other at the first samples, however large they are.
    """
    deviation, dynamics = problem.initial_deviation, problem.dynamics
    counted = np.flatnonzero(problem.structure.state_number)  # since the record's beginning
    if deviation is None and beginning is None and not problem.inputs.unmeasured and not counted.size:
        return None
    force, _ = force_and_velocity_scale(problem)
    # Of modes a coordinate moves so much less than a DOF, and so much more force acts on it.
    per_dof = problem.structure.shapes.scale
    std = np.full((dynamics.size, 2), np.inf)
    if deviation is not None:
        std[: dynamics.ndof] = np.array(deviation) / per_dof
        std[dynamics.hidden, 0] = RESIDUAL_MOTION * force
    std[dynamics.hidden.start + counted, 0] = RESIDUAL_MOTION * force
    std[dynamics.forces] = FIRST_FORCE * force / newtons(problem)[:, None] * np.array((1.0, problem.inputs.force_edge))
    if beginning is None:
        return State.about_zero(0, std)
    numbers = beginning.of_functions(dynamics.ndof, dynamics.hidden, dynamics.size)
    std[numbers >= 0] = TIE * beginning.std[numbers[numbers >= 0]]
    column = np.where(numbers >= 0, len(problem.uncertain) + numbers, -1)
    value, unit = (np.array([getattr(p, name) for p in beginning.uncertain]) for name in ("prescribed", "prior_std"))
    return State(0, std, column, value, unit)
