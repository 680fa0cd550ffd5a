"""The identified system left to itself: under the force that it was found with, and on data that no estimator has seen.

A training ties parameters and response together only through a loss, so a small loss can go with wrong parameters.
Simulating the estimated system from the estimated initial state under the measured force leaves no such room: the
parameters alone shape the response, and their error adds up over the record.

A run on other data begins at rest, or where the estimate leaves the structure, and only its force and the motion of its
ground are looked at. Its band holds what is uncertain: the parameters, the start, the noise of the load cells and of
the ground's sensor, and the discrepancy, all as they were found. The discrepancy acts as a random force, as the
estimator takes it: an error of the model that follows the motion, such as a forgotten nonlinearity, is none, and may
lead out of the band.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd

from pinn_cli.record.channel import Channel
from pinn_cli.record.channels import channels
from pinn_cli.record.ensemble import Members, affordable_members, spread_of
from pinn_cli.record.free_run import NoFreeRunError, free_run_of, is_linear
from pinn_cli.record.free_run import free_run as motion_of
from pinn_cli.record.inputs import SupportErrors
from pinn_cli.record.record import MINIMUM_SAMPLES, Record
from pinn_cli.record.response import RESPONSE_QUANTITIES, Response
from pinn_cli.record.validation_data import ValidationRecord
from pinn_cli.report.fitness import fitness_percent, fitness_table, nmse_percent
from pinn_cli.system.coupling import holding, loose_dofs
from pinn_cli.system.parameters import MASS
from pinn_cli.system.priors import HALF_WIDTH_95
from pinn_cli.system.quantities import FORCE, GROUND, UNITS
from pinn_cli.system.structure import Structure
from pinn_cli.training.calibrated_record import as_felt, compared_record
from pinn_cli.training.estimate import Estimate, estimated_structure
from pinn_cli.training.noise_model import FoundNoise
from pinn_cli.training.prediction import drawn_structures, parameter_draws

REFERENCES = ("truth", "sensors", "estimate")

# Agreement of displacements, by the printed formula, below which a free run contradicts the estimate. 6-DOF Duffing
# chain, one load cell: right parameters give 99.9, 99 and 96 to 98 % at 50, 20 and 10 dB; a linear model 91 % (62 with
# its parameters held fixed), parameters held 5 to 10 % off 84 %.
CONTRADICTED_BELOW = 95.0

# One over the share of the record at its start that is left out where the start is not to count: there the ends of
# splines show, and the motion far from the sensors is poorly known for as long as a wave takes to get there. A run that
# parts from itself is begun anew as often.
EXCUSED_SHARE = 10
# Such short runs tell of parameters if masses that are so many times as large contradict the estimate in them.
TELLING_MASSES = 1.03

VALIDATION_COLUMNS = (
    "quantity", "dof", "unit", "start_time", "stop_time", "begins", "samples", "signal_rms", "error_rms",
    "nmse_percent", "band_rms", "sigma", "inside_95_percent",
)  # fmt: skip
# Draws of what is uncertain: a standard deviation from so many is good to 9 %.
FREE_RUN_DRAWS = 64


@dataclass(frozen=True, eq=False)
class FreeRun:
    """What came of a free run.

    Attributes:
        response: Of the estimated system, (N, n) each, with the measured force; None where there is none.
        finding: Why there is none, or what is wrong with it, in plain words; "" where nothing is.
        agreement: With the estimated displacements where neither noise nor the start explains how far it is off, %;
            NaN where it is not, or noise or the start does.
    """

    response: Response | None
    finding: str = ""
    agreement: float = math.nan


def free_run(prescribed: Structure, estimate: Estimate, record: Record) -> FreeRun:
    """Simulate the estimated system from the estimated initial state under the measured force.

    No free run is an error: a force that is neither measured nor known to be zero, and a system too stiff or unstable,
    are findings. Between the samples of the record force, ground and supports do what its ``intersample`` says.
    """
    structure = estimated_structure(prescribed, estimate.parameters)
    try:
        response = free_run_of(structure, record, estimate.response, 0)
    except NoFreeRunError as error:
        return FreeRun(None, str(error))
    agreement = _agreement(structure, response, estimate.response)
    if not agreement < CONTRADICTED_BELOW:
        return FreeRun(response)
    extent = f"to {agreement:.1f} % only" if agreement > 0.0 else "not at all"
    first = len(record.time) // EXCUSED_SHARE
    excused, anew = _excused_agreements(structure, estimate, record, first)
    said = f"the free run's displacements agree with the estimate {extent}"
    if excused >= CONTRADICTED_BELOW:
        later = f"under the estimated force and from {record.time[first]:.4g} s on, to {excused:.1f} %"
        why = "the noise of the measured force or the estimated start explains it"
        return FreeRun(response, f"{said}; {later}: {why}")
    if not math.isnan(anew):
        why = f"begun anew at every tenth of the record, to {anew:.1f} %"
        told = "the motion is chaotic, or nearly so: what is next to nothing at first grows"
        return FreeRun(response, f"{said}; {why}: {told}")
    finding = f"in a free run their displacements agree with it {extent}"
    why = "the model, the parameters or the response is wrong"
    warning = f"warning: the estimated parameters do not reproduce the estimated response: {finding}; {why}"
    return FreeRun(response, warning, agreement)


def free_run_table(run: FreeRun, estimate: Estimate, record: Record, truth: Response) -> pd.DataFrame:
    """Both fitness formulas of the free run's motion (the content of ``free_run.csv``); the force is given.

    Its columns are those of `pinn_cli.report.fitness.fitness_table` and, before them, ``against``: `REFERENCES`. Cells
    are empty where the run has no response, or its reference is unknown. The sensors are noisy; averages over groups
    go over the DOFs that have one.
    """
    response = run.response or Response.unknown(record.time, record.ndof)
    sensors = Response(record.time, record.displacement, record.velocity, record.acceleration, record.force)
    tables = []
    for name, reference in zip(REFERENCES, (truth, sensors, estimate.response), strict=True):
        table = fitness_table(response, reference, record.observed)
        table.insert(0, "against", name)
        tables.append(table[table["quantity"].isin(RESPONSE_QUANTITIES)])
    return pd.concat(tables, ignore_index=True)


def _excused_agreements(structure: Structure, estimate: Estimate, record: Record, first: int) -> tuple[float, float]:
    """Agreement where only the model and its parameters can be to blame, %; NaN where a run overflows.

    Two things move a right system away from its estimate as well: the noise of the measured force and of the ground's
    acceleration, of which the estimated ones are free, and the start, which nothing before it pins down. Where every
    DOF carries a force that is estimated from the motion alone, this excuses wrong parameters too: the estimated force
    makes up for them.

    The second number is the median of runs that begin anew wherever as many samples as ``first`` are over; NaN of a
    linear structure, and where they contradict the estimate, too, or are too short to tell anything. A nonlinear one
    may part from itself by a thousandth of a stiffness, or the noise of a good load cell: at a few places, or
    everywhere where it is chaotic.
    """
    response = estimate.response
    force = np.where(record.sensors("force"), response.force, record.force)
    ground = record.ground_acceleration if response.ground_acceleration is None else response.ground_acceleration
    acting = replace(record, force=force, ground_acceleration=ground)
    supports = response.supports

    def agreement(of: Structure, begin: int, end: int) -> float:
        part = acting if supports is None else acting.carried_by(supports, begin)
        try:
            run = free_run_of(of, part.until(end), response, begin, begin)
        except NoFreeRunError:
            return math.nan
        return _agreement(of, run, response.part(begin, end))

    def anew(of: Structure) -> float:
        return float(np.median([agreement(of, i * first, (i + 1) * first) for i in range(EXCUSED_SHARE)]))

    excused = agreement(structure, first, len(record.time))
    if excused >= CONTRADICTED_BELOW or is_linear(structure) or first < MINIMUM_SAMPLES:
        return excused, math.nan
    again, heavier = anew(structure), structure.with_parameters(m=TELLING_MASSES * structure.parameters[MASS])
    return excused, again if again >= CONTRADICTED_BELOW > anew(heavier) else math.nan


def _agreement(structure: Structure, response: Response, reference: Response) -> float:
    """Printed fitness of the displacements against the last of others, mean over DOFs, %; NaN if none moves.

    Where nothing holds the structure, of its springs' elongations: nothing tells how far it goes as a whole.
    """
    last = reference.part(len(reference.time) - len(response.time), len(reference.time))
    if loose_dofs(structure):
        springs = holding(structure)
        scores = fitness_percent(*(structure.elongation(of.stretching[0])[:, springs] for of in (response, last)))
    else:
        scores = fitness_percent(response.displacement, last.displacement)
    return float(np.mean(scores[np.isfinite(scores)])) if np.isfinite(scores).any() else math.nan


@dataclass(frozen=True, eq=False)
class ValidationRun:
    """What came of it; the first samples may be a run-up that is not compared.

    Attributes:
        record: The data, in SI units, with the calibrations that were found.
        noise: Of the sensors, as it was found.
        first: Sample from which on they are compared.
        at_rest: Whether the run begins at rest.
        response: Of the identified system, (N, n) each; None where there is none.
        std: Of the same; NaN where it is unknown.
        finding: Why there is no run; "" where there is one.
    """

    record: Record
    noise: FoundNoise
    first: int
    at_rest: bool
    response: Response | None
    std: Response | None
    finding: str = ""

    @classmethod
    def of(
        cls,
        prescribed: Structure,
        estimate: Estimate,
        seen: Record,
        data: ValidationRecord,
        draws: np.ndarray | None = None,
        seed: int = 0,
    ) -> ValidationRun:
        """Simulate the identified system on data other than the record that was seen.

        ``draws`` (D, p) are of the parameters' posterior; None: of a Gaussian with their deviations. The estimate has
        the state that the run may begin with.
        """
        record = as_felt(data.record, estimate.parameters)
        structure = estimated_structure(prescribed, estimate.parameters)
        at_rest = data.begins is None
        start = None if data.begins is None else estimate.response.state(data.begins)
        if data.begins is not None and estimate.response.supports is not None:
            record = replace(record, supports_begin=estimate.response.supports[data.begins, :2])
        try:
            response = motion_of(structure, record, start)
        except NoFreeRunError as error:
            return cls(record, estimate.noise, data.first, at_rest, None, None, str(error))
        members = _members(structure, estimate, (seen, record), data.begins, draws, seed)
        std = None if members is None else spread_of(members, structure, record, response)
        compared = compared_record(record, estimate.parameters, response)
        return cls(compared, estimate.noise, data.first, at_rest, response, std)

    def of_channel(self, channel: Channel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Measured, NaN where no sample was taken, simulated, and its deviation, from the first sample compared on."""
        unknown = np.full(len(self.record.time), np.nan)
        measured = np.where(channel.there, channel.measured, np.nan)
        run, std = (unknown if x is None else channel.of(x) for x in (self.response, self.std))
        return measured[self.first :], run[self.first :], std[self.first :]

    def compared(self, channel: Channel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same where a sample was taken, each (M,)."""
        measured, run, std = self.of_channel(channel)
        there = channel.there[self.first :]
        return measured[there], run[there], std[there]

    @cached_property
    def table(self) -> pd.DataFrame:
        """One row per response sensor of the other data (the content of ``validation.csv``): `VALIDATION_COLUMNS`.

        ``dof`` is counted from 1. ``begins`` is ``rest`` or ``estimate``. In the sensor's ``unit``: ``signal_rms``
        (about the mean), ``error_rms`` of measured less simulated, ``band_rms`` (the deviation of what is simulated,
        root mean square over time) and ``sigma`` (the sensor's noise, as it was found). ``nmse_percent``: 100 mean
        square error over the signal's variance. ``inside_95_percent``: samples within 1.96 deviations, noise included.
        What is not known is empty (NaN).
        """
        rows, time = [], self.record.time
        for channel in channels(self.record, RESPONSE_QUANTITIES):
            measured, simulated, std = self.compared(channel)
            error, sigma = measured - simulated, self.noise.of(channel)
            reach, spread = HALF_WIDTH_95 * np.hypot(std, sigma), std[np.isfinite(std)]
            finite = np.isfinite(reach) & np.isfinite(error)
            inside = np.abs(error[finite]) <= reach[finite]
            rows.append(
                (
                    channel.quantity, channel.dof + 1, UNITS[channel.quantity], float(time[self.first]),
                    float(time[-1]), "rest" if self.at_rest else "estimate", len(measured), float(np.std(measured)),
                    float(np.sqrt(np.mean(error**2))), nmse_percent(error, measured),
                    float(np.sqrt(np.mean(spread**2))) if spread.size else np.nan, sigma,
                    100.0 * float(np.mean(inside)) if inside.size else np.nan,
                )
            )  # fmt: skip
        return pd.DataFrame(rows, columns=list(VALIDATION_COLUMNS))


def with_noise_of(estimate: Estimate, records: Sequence[Estimate]) -> Estimate:
    """The estimate of one record with the noise of sensors that only others of its structure's records had."""
    sensors = dict(estimate.noise.sensors)
    for quantity in RESPONSE_QUANTITIES:
        for record in records:
            other = record.noise.sensors.get(quantity)
            if other is not None:
                first = sensors.get(quantity, other)
                sensors[quantity] = np.where(np.isnan(first), other, first)
    return replace(estimate, noise=replace(estimate.noise, sensors=sensors))


def _members(
    structure: Structure,
    estimate: Estimate,
    records: tuple[Record, Record],
    begins: int | None,
    draws: np.ndarray | None,
    seed: int,
) -> Members | None:
    """What may be otherwise than in the run, drawn; None where the training does not say how uncertain parameters are.

    ``records`` are what the estimator saw, and the other data.
    """
    count = affordable_members(structure, records[1], FREE_RUN_DRAWS)
    if draws is None:
        draws = parameter_draws(estimate.parameters, estimate.correlation, count, seed)
    else:
        draws = draws[np.linspace(0, len(draws) - 1, min(count, len(draws))).round().astype(int)]
    if draws is None:
        return None
    zeros, hidden = np.zeros(structure.coordinates), np.zeros(len(structure.memory))
    at_rest = [zeros, zeros, *([hidden] if len(hidden) else [])]
    start = at_rest if begins is None else estimate.response.state(begins)
    spread = [np.zeros_like(x) for x in start] if begins is None else estimate.state_std(structure, begins)
    state, deviation = np.concatenate(start), np.concatenate(spread)
    normals = np.random.default_rng([seed, 3]).standard_normal((len(draws), len(state)))
    sources = _sources(structure, estimate, *records)
    parameters = drawn_structures(structure, estimate.parameters, draws)
    errors = SupportErrors.of(records[1], estimate.noise.sensors)
    return Members(parameters, state + deviation * normals, sources, seed, carried=errors)


def _sources(structure: Structure, estimate: Estimate, seen: Record, record: Record) -> np.ndarray:
    """(P, n), see :class:`pinn_cli.record.ensemble.Members`: discrepancy, load cells, and the ground's sensor.

    The discrepancy has the same power at every frequency, whatever the rate that it is sampled at.
    """
    n, noise = structure.coordinates, estimate.noise
    level = noise.discrepancy
    rows = [] if np.isnan(level) else [*(level * np.sqrt(seen.step / record.step) * np.eye(n))]
    shapes = structure.shapes.matrix
    for dof, sigma in enumerate(noise.sensors.get(FORCE, ())):
        if np.isfinite(sigma) and dof < len(shapes) and not record.unforced[dof]:
            rows.append(sigma * shapes[dof])
    if record.ground_acceleration is not None:
        moved = structure.parameters_like(np.empty(0))[MASS] * structure.with_ground
        rows += [sigma * moved for sigma in noise.sensors.get(GROUND, ()) if np.isfinite(sigma)]
    return np.array(rows).reshape(-1, n)
