"""What is wrong with the structure or with its clock: one mass, or the unit of the time axis.

Of the masses, all storeys and factors are simulated at once from the start of the record: first over a few periods of
the first mode, where a factor that is some per cent off still shows, then over more of it around the best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from pinn_cli.record.channels import channels
from pinn_cli.record.runge_kutta_step import runge_kutta_step
from pinn_cli.record.steps import substeps_needed
from pinn_cli.system.modes import modes_of
from pinn_cli.verdict.channel_faults import MENDS_BY_MOVING, REPRODUCED
from pinn_cli.verdict.comparison import worst_misfit
from pinn_cli.verdict.finding import Finding
from pinn_cli.verdict.prediction import between_samples, predicted

if TYPE_CHECKING:
    from pinn_cli.record.record import Record
    from pinn_cli.system.structure import Structure

# Seconds that the unit of the time axis may be long.
UNITS = {1e-3: "milliseconds", 1e-6: "microseconds", 1e3: "thousands of seconds", 60.0: "minutes", 1 / 60: "1/60 s"}
# A highest natural frequency up to this times the Nyquist frequency may be seen in the record.
SEEN = 1.3
# Of a mass, from the least to the largest, 11 % apart: over ten periods the response of a structure whose frequency is
# 3 % off is still half right.
COARSE = np.geomspace(1 / 12, 12, 46)
FINE = np.geomspace(1 / 1.12, 1.12, 17)
PERIODS, MORE_PERIODS = 10.0, 40.0
MOST_STEPS = 12_000
# A factor nearer to one is no mistake of a person's.
LEAST_FACTOR = 1.1
# Steps times hypotheses times DOFs that are simulated at most: 50 DOFs would take minutes and gigabytes.
MOST_WORK = 10_000_000
# NMSE that counts as none: beyond it, one channel must not outweigh the others, and nothing is left to mend.
FLOOR = 1e-3


def time_unit_fault(structure: Structure, record: Record, excused: Sequence[str] = ()) -> Finding | None:
    """The unit of time in which the structure predicts every sensor; None where seconds will do, or no unit does.

    Args:
        structure: Whose natural frequencies should be in the record's band, below its Nyquist frequency.
        record: With its time as given.
        excused: Names of channels that have a fault of their own.
    """
    if not np.isfinite(record.force).all() or in_band(structure, record):
        return None
    for seconds in UNITS:
        scaled = replace(record, time=record.time * seconds)
        if not in_band(structure, scaled) or (prediction := predicted(structure, scaled)) is None:
            continue
        left = worst_misfit(prediction, excused)
        if left <= REPRODUCED:
            return unit_finding(seconds, left)
    return None


def unit_finding(seconds: float, left: float) -> Finding:
    """That the unit of the time axis is so many seconds long."""
    reason = f"the structure does what was measured if the time is in {UNITS[seconds]}"
    return Finding("time_unit", "time", f"{reason}; multiply the time column by {seconds:.6g}", "failed", left)


def has_faults(structure: Structure, record: Record, excused: Sequence[str] = ()) -> bool:
    """Whether there is anything to mend: a structure that does what was measured has the right masses and units."""
    return worst_misfit(predicted(structure, record), excused) >= FLOOR


def in_band(structure: Structure, record: Record) -> bool:
    """Whether the record is sampled fast enough for the structure, and long enough for a period of its first mode."""
    frequencies = modes_of(structure).natural_frequencies
    if not np.isfinite(frequencies).all():
        return False
    return bool(frequencies[-1] < SEEN * 0.5 / record.step and frequencies[0] > 1.0 / record.duration)


def mass_fault(structure: Structure, record: Record, excused: Sequence[str] = ()) -> Finding | None:
    """The mass that mends the prediction, and its factor; None where no single one does.

    Args:
        structure: Whose masses are doubted, one at a time.
        record: What was measured.
        excused: Names of channels that have a fault of their own.
    """
    if not np.isfinite(record.force).all() or structure.shapes is not None or record.supports:
        return None
    before = worst_misfit(predicted(structure, record), excused)
    dofs = np.repeat(np.arange(structure.ndof), len(COARSE))
    factors = np.tile(COARSE, structure.ndof)
    score = _scores(structure, record, dofs, factors, PERIODS, excused)
    if not np.isfinite(score).any():
        return None
    best = int(np.argmin(score))
    dof, factor = int(dofs[best]), float(factors[best])
    for periods, spread in ((PERIODS, 1.0), (MORE_PERIODS, 0.25)):
        tried = factor * FINE**spread
        score = _scores(structure, record, np.full(len(tried), dof), tried, periods, excused)
        factor = float(tried[np.argmin(score)])
    if 1 / LEAST_FACTOR < factor < LEAST_FACTOR:
        return None
    left = worst_misfit(predicted(_with_mass(structure, dof, factor), record), excused)
    if left > REPRODUCED or left > MENDS_BY_MOVING * before:
        return None
    return mass_finding(structure, dof, factor, "the structure", left)


def mass_finding(structure: Structure, dof: int, factor: float, which: str, left: float) -> Finding:
    """That a structure with so many times the mass of a DOF, counted from 0, does what was measured."""
    given = structure.parameter("m", dof)
    name, mass = given.name, given.prescribed * factor
    reason = f"with {name} = {mass:.4g} kg, {factor:.3g} times what is prescribed, {which} does what was measured"
    return Finding("mass", name, f"{reason}; check {structure.labels.setting(given)}", left=left)


def _with_mass(structure: Structure, dof: int, factor: float) -> Structure:
    scale = torch.ones_like(structure.parameters["m"])
    scale[dof] = factor
    return structure.with_parameters(m=structure.parameters["m"] * scale)


def _scores(
    structure: Structure,
    record: Record,
    dofs: np.ndarray,
    factors: np.ndarray,
    periods: float,
    excused: Sequence[str],
) -> np.ndarray:
    """(H,) mean logarithm of the channels' NMSE for hypotheses of one mass each; infinite where there is none.

    A sum of logarithms lets one channel be bad where all others are right.
    """
    seen = channels(record, excused=excused)
    masses = np.tile(structure.parameters["m"].numpy().astype(float), (len(dofs), 1))
    masses[np.arange(len(dofs)), dofs] *= factors
    samples, substeps = _span(structure, record, masses, periods)
    if not seen or samples < 4 * structure.ndof:
        return np.full(len(dofs), np.inf)
    motion = _simulated(structure, record, masses, samples, substeps)
    total = np.zeros(len(dofs))
    for c in seen:
        measured = c.measured[:samples]
        power = max(float(np.mean(measured**2)), np.finfo(float).tiny)
        with np.errstate(over="ignore"):  # of masses with which the motion grows without bound
            misfit = np.mean((motion[:, c.order, :, c.dof] - measured[:, None]) ** 2, axis=0) / power
        total += np.log(misfit + FLOOR)
    return np.where(np.isfinite(total), total / len(seen), np.inf)


def _span(structure: Structure, record: Record, masses: np.ndarray, periods: float) -> tuple[int, int]:
    """How many samples to follow, and in how many steps each."""
    first = float(np.nanmin(modes_of(structure).natural_frequencies))
    lightest = structure.with_parameters(m=torch.as_tensor(masses.min(axis=0)))
    substeps = max(1, -(-substeps_needed(lightest, record.step) // 2))  # twice the step: a per cent will do
    wanted = periods / (first * record.step) if first > 0 else len(record.time)
    return int(min(len(record.time), wanted, MOST_STEPS // substeps, MOST_WORK // (substeps * masses.size))), substeps


def _simulated(
    structure: Structure,
    record: Record,
    masses: np.ndarray,
    samples: int,
    substeps: int,
) -> np.ndarray:
    """(samples, 3, H, n): displacement, velocity and acceleration of every hypothesis, from rest."""
    own = structure.parameters_like(np.empty(0))
    parameters = {**own, "m": masses}

    def slope(z: np.ndarray, load: np.ndarray) -> np.ndarray:
        f, carried = load
        return np.array((z[1], structure.acceleration(z[0], z[1], f, parameters) - carried))

    step = record.step / substeps
    load = _half_steps(record, samples, substeps, structure.with_ground)
    relative = record.frame == "relative"
    z = np.zeros((2, *masses.shape))
    out = np.empty((samples, 3, *masses.shape))
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(samples):
            out[k, :2] = z
            out[k, 2] = structure.acceleration(z[0], z[1], record.force[k], parameters)
            if relative:
                out[k, 2] -= load[2 * k * substeps, 1]
            for s in range(substeps):
                at = 2 * (k * substeps + s)
                z = runge_kutta_step(slope, z, load[at], load[at + 1], load[at + 2], step)
    return out


def _half_steps(record: Record, samples: int, substeps: int, with_ground: np.ndarray) -> np.ndarray:
    """(2 samples substeps + 1, 2, n): at every half step the force, and what the ground's acceleration takes away."""
    if record.intersample == "zero_order_hold":
        force = np.repeat(record.force[:samples], 2 * substeps, axis=0)
        force = np.concatenate((force, force[-1:]))
        return np.stack((force, np.zeros_like(force)), axis=1)
    times = record.time[0] + 0.5 * record.step / substeps * np.arange(2 * samples * substeps + 1)
    times = np.minimum(times, record.time[-1])
    part = min(samples + 1, len(record.time))
    force, carried = between_samples(record, record.force, part)(times), np.zeros((len(times), record.ndof))
    if record.ground_acceleration is not None:
        carried += between_samples(record, record.ground_acceleration, part)(times)[:, None] * with_ground
    return np.stack((force, carried), axis=1)
