"""What an estimator is given: a prescribed chain, a record, and which parameters may move. Never the truth.

Beside the forces that were measured there act the ground, and forces that nobody measured.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.linalg import qr

from pinn_cli.model.knowledge import EndState, Levels, ParameterKnowledge
from pinn_cli.record.channels import motion_amplitudes, record_band
from pinn_cli.record.record import Record
from pinn_cli.record.steps import has_stiff_law
from pinn_cli.settings.errors import InputError
from pinn_cli.system.basis import in_basis_of, shares_basis, term_size
from pinn_cli.system.dynamics import Dynamics
from pinn_cli.system.functions import FLAT, Inputs
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.priors import Prior
from pinn_cli.system.quantities import FORCE
from pinn_cli.system.structure import Structure

# What measured accelerations can be compared with.
THROUGH = ("derivative", "observer", "both")
# How the motion of a record may begin: anyhow, or at rest.
BEGINNINGS = FREE, REST = "free", "rest"
# How a force that nobody measured is estimated: as a Gaussian process, or as whatever the motion takes.
GAUSSIAN_PROCESS = "gaussian_process"
UNKNOWN_FORCES = (GAUSSIAN_PROCESS, FREE)
# Periods of the record's highest frequency that the correlation time of an unknown force starts at: its edge is there.
FIRST_CORRELATION = FLAT / math.pi
# A structure that somebody calls at rest still moves a little: so much of what it does later.
RESIDUAL_MOTION = 1e-3
# Speed below which contacts that stick creep in the equations of an estimator, over the record's rms velocity. With ten
# times as much, damping is 50 % off; with 1e-7 m/s, solutions ended far from the most probable one.
STICKS_BELOW = 0.005
# Knot intervals from a turn within which a spline rings.
RINGS = 3.0


@dataclass(frozen=True, eq=False)
class TurningPoints:
    """When contacts stick or turn round, so that an estimator's features follow the motion badly.

    Attributes:
        time: (T,), s, ascending.
        level: Error of the equations of motion about these, N, as they are enforced.
        looser: How many times that of all other times it is.
        discrepancy: Of the solution that turns there, N.
    """

    time: np.ndarray
    level: float
    looser: float
    discrepancy: float

    def near(self, time: np.ndarray, spacing: float) -> np.ndarray:
        """(I,) bool: which times are within a few intervals, of so many seconds, of one of them."""
        if not len(self.time):
            return np.zeros(len(time), dtype=bool)
        after = np.searchsorted(self.time, time)
        distances = [np.abs(time - self.time[np.clip(after - k, 0, len(self.time) - 1)]) for k in (0, 1)]
        return np.minimum(*distances) < RINGS * spacing


@dataclass(frozen=True, eq=False)
class SpectralEstimate:
    """What spectra say of parameters; the motion under a measured force then says no more of them.

    Attributes:
        parameters: Whose prescribed values are the most probable ones.
        covariance: (p, p), in the parameters' units.
        log_likelihood: Of the spectra.
        levels: Quantity to (dofs,), standard deviation of the white noise of its sensors; NaN where there is none.
        misfit: Part of the sensors' power that is left in the part of the spectra that fits worst, beyond noise.
        missing: Frequency, Hz, of a mode that the spectra show and the structure does not have; None: there is none.
    """

    parameters: tuple[Parameter, ...]
    covariance: np.ndarray
    log_likelihood: float
    levels: Mapping[str, np.ndarray]
    misfit: float
    missing: float | None = None


@dataclass(frozen=True, eq=False)
class Problem:
    """What is asked of one record.

    Attributes:
        structure: The prescribed model; of an unknown parameter it has the value at which it starts.
        record: What was measured, with the sensors that the scheme allows.
        uncertain: The parameters that may move; all others are held at their prescribed values.
        acceleration_through: Whether measured accelerations are compared with the network's second derivative
            (``derivative``), with the observer equation (paper, eq. 8; ``observer``), or with ``both``.
        initial_motion: Whether the motion begins anyhow (``free``) or at ``rest`` at the record's first sample.
        inputs: What acts beside measured forces.
        prior: What earlier records say of the uncertain parameters together, whose own values are what bounds leave of
            it; None: each is believed by itself.
        earlier_levels: Noise that the last record was found to have: near it this one's is looked for; None: no earlier
            record says.
        initial_state: Where the motion of an earlier record ended, if this one goes on from there: its first sample is
            that record's last. The parameters of ``with_parameters`` are the first of ``uncertain``.
        turning_points: Where the equations of motion hold less well for a spline; None: they hold everywhere alike.
        spectral: What spectra say of all uncertain parameters; None: the motion tells them.
        hand_over: When a later record goes on, s: what is known from the samples up to that time is kept as well.
    """

    structure: Structure
    record: Record
    uncertain: tuple[Parameter, ...] = ()
    acceleration_through: str = "derivative"
    initial_motion: str = FREE
    inputs: Inputs = field(default_factory=Inputs)
    prior: ParameterKnowledge | None = None
    earlier_levels: Levels | None = None
    initial_state: EndState | None = None
    hand_over: float | None = None
    turning_points: TurningPoints | None = None
    spectral: SpectralEstimate | None = None

    def present(self, values: Mapping[str, np.ndarray]) -> Problem:
        """The same with damping of the whole in the modes of some masses and stiffnesses, see `Structure.present`."""
        return replace(self, structure=self.structure.present(values))

    def in_basis_of(self, structure: Structure) -> Problem:
        """The same with its structure in the coordinates and with the functions of laws that another of it has.

        A term may then be as large as its function is smooth.
        """
        if shares_basis(structure, self.structure):
            return self
        before, structure = self.structure, in_basis_of(self.structure, structure)
        held = {p: float(structure.parameters[p.kind][p.index]) for p in structure.every_parameter()}
        widened = {p: term_size(structure, p) / term_size(before, p) for p in held if p.curve}
        moved = tuple(
            replace(p, prescribed=held.get(p, p.prescribed), prior_std=p.prior_std * widened.get(p, 1.0))
            for p in self.uncertain
        )
        return replace(self, structure=structure, uncertain=moved)

    @cached_property
    def dynamics(self) -> Dynamics:
        """The equations of the structure in all unknown functions of time.

        A spline follows no motion that stops dead: contacts stick up to a speed that is small beside the record's.
        """
        if not has_stiff_law(self.structure) or not self.record.observed.any():
            return Dynamics(self.structure, self.inputs)
        speed = STICKS_BELOW * motion_amplitudes(self.record)["velocity"]
        return Dynamics(self.structure.turning_over(speed), self.inputs)

    @property
    def initial_deviation(self) -> tuple[float, float] | None:
        """Prior standard deviations of every DOF's displacement (m) and velocity (m/s) at the first sample.

        A thousandth of the record's rms displacement and velocity where the motion begins at rest; None where nothing
        is known about its beginning, or an earlier record says it.
        """
        if self.initial_state is not None or self.initial_motion == FREE:
            return None
        size = motion_amplitudes(self.record)
        return RESIDUAL_MOTION * size["displacement"], RESIDUAL_MOTION * size["velocity"]

    @property
    def priors(self) -> tuple[Prior, ...]:
        """Of the uncertain parameters, in their order; none where estimates with standard deviations will do."""
        return tuple(parameter.prior for parameter in self.uncertain if parameter.prior is not None)

    @property
    def identifies(self) -> bool:
        """Whether any parameter is unknown."""
        return any(parameter.unknown for parameter in self.uncertain)


def inputs_of(structure: Structure, record: Record, unknown_force: str = GAUSSIAN_PROCESS) -> Inputs:
    """What acts beside measured forces; how an unknown force is estimated is one of :data:`UNKNOWN_FORCES`.

    Raises:
        InputError: A record that a structure in modal coordinates cannot be asked about.
    """
    left_open = ~record.unforced & ~record.sensors(FORCE)
    if structure.is_modal:  # forces on modes are the same ones as on the DOFs
        if record.intersample != "band_limited":
            allowed, hint = "band_limited with system=matrices", "a held force is no force of a mode"
            raise InputError("data.intersample", record.intersample, allowed, hint)
        if unknown_force == FREE and left_open.any():
            hint = "the motion of a few modes leaves no force open"
            raise InputError("scheme.unknown_force", FREE, f"{GAUSSIAN_PROCESS} with system=matrices", hint)
        if record.ground_acceleration is not None:
            structure.shapes.check_ground()
    forces = tuple(int(dof) for dof in np.flatnonzero(left_open)) if unknown_force == GAUSSIAN_PROCESS else ()
    if forces and record.misses_ground:
        allowed, hint = "measured where nobody measured the ground", "nothing tells one from the other"
        raise InputError("data.force", f"null on {record.dof_names(forces)}", allowed, hint)
    functions = structure.is_modal or any(channel.quantity == FORCE for channel in record.calibrated)
    loads = tuple(int(dof) for dof in np.flatnonzero(record.sensors(FORCE))) if functions else ()
    filters = tuple(channel.index for channel in record.calibrated if channel.filter_order)
    together = bool(filters) or not all(channel.feels_one for channel in record.calibrated)
    moved = record.ground_acceleration is not None or bool(record.supports)
    if not (forces or loads or moved or len(structure.memory)):
        return Inputs(together=together, filters=filters)
    band = record_band(record)
    return Inputs(
        record.ground_acceleration is not None,
        record.frame == "absolute",
        forces,
        FIRST_CORRELATION / band,
        rate=math.pi * band,
        edge=2.0 * math.pi * band,
        loads=loads,
        together=together,
        filters=filters,
        supports=tuple(record.supports),
        misses_ground=record.misses_ground,
    )


def with_every_force(problem: Problem) -> Problem:
    """The same problem with a force that nobody measured on every coordinate, beside those that were.

    Where these are modes, on as many DOFs, which they move in the most different ways.
    """
    band, shapes = record_band(problem.record), problem.structure.shapes.matrix
    dofs = np.sort(qr(shapes.T, mode="r", pivoting=True)[1][: shapes.shape[1]])
    inputs = replace(
        problem.inputs,
        forces=tuple(dofs.tolist()),
        correlation_time=FIRST_CORRELATION / band,
        rate=math.pi * band,
        edge=2.0 * math.pi * band,
        left_out=True,
    )
    return replace(problem, inputs=inputs)
