"""Every noise level by evidence: each response sensor's, each force sensor's and the discrepancy (MacKay 1992).

At the most probable level of a white noise, sigma^2 = |r|^2 / (N - gamma), with r the residuals under it and gamma how
many of the N values the solution has taken up: the sum over time of the output's posterior variance over sigma^2. Where
two noises add up in one residual, the sensor of a force and the discrepancy, each gets the part of both sums that its
share of the variance gives it. A level that is right already stays where it is.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import numpy as np

from pinn_cli.record.channel import CALIBRATED
from pinn_cli.record.channels import FINEST_KNOWN
from pinn_cli.system.quantities import FORCE
from pinn_cli.training.evidence import Evidence, Trained
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.record_evidence import ForceResiduals, RecordEvidence, RecordSolution
from pinn_cli.training.sensor_samples import SensorSamples
from pinn_cli.training.steps.discrepancy_search import NEGLIGIBLE_GAIN, negligible
from pinn_cli.training.steps.force_spectrum import DRAWS, drive_below, levels_of_a_kind

# Rounds at most, and the relative change of a level below which nothing that is reported would change.
ROUNDS, SETTLED = 25, 0.01
# So many rounds one after the other that lose so much log evidence end it: rounding rules. So do as many that gain
# nothing.
LOSING, LOST = 2, 10.0
IDLE = 4
# Most that a standard deviation may change in one round: the solution under it has to follow.
LARGEST_CHANGE = 10.0
# Change of the logarithm of a level below which the factor of the solution before serves: its Hessian is off by a
# factor of two at most.
NEAR_LEVEL = 0.35
# Values that are left of N at the least: where features follow every sample, rounding is all that N - gamma would be.
FEWEST_LEFT = 1e-3
# Part of the samples that a sensor's usual noise counts for where the record leaves it open, since the motion follows
# it wherever it goes; it falls off with this power of the share of its values that the solution has taken up, to
# nothing for a sensor that the model checks.
KINSHIP, OPENNESS = 0.2, 4
# The same of any sensor where forces are unknown, which leave more of it open: with less, every tenth sensor came out
# half as noisy as it was, and the bands of its motion held two thirds of it.
KINSHIP_UNDER_FORCES = 0.05
# An accelerometer beside a load cell, about whose noise nothing is known, has this part of what the load cell's noise
# makes of the acceleration, at most: that much of it passes for the load cell's.
BESIDE_LOAD_CELL = 0.4
# Steps of a level that shrink by a steady ratio are taken at once, so many of them at most.
LONGEST_STRIDE = 5.0


def settled(evidence: Evidence, trained: Trained, pooled: bool = False, rounds: int = ROUNDS) -> Trained:
    """Alternate noise levels and solution until neither moves, or until the record gets no more probable.

    Args:
        evidence: Of the problem.
        trained: Where to begin; its discrepancy is that of a search.
        pooled: Whether the sensors of one quantity share one level.
        rounds: At most.
    """
    if evidence.problem.first.spectral is not None:  # spectra say what the levels are, too
        return trained
    floors = evidence.each_record(floor, trained)
    before: list[np.ndarray | None] = [None] * len(floors)
    best, losing, idle = trained, 0, 0
    for _ in range(rounds):
        updates = evidence.each_record(updated, trained, floors)
        updates = [noise.pooled() for noise in updates] if pooled else updates
        levels = trained.noise.records
        if trained.noise.held:
            triples = zip(updates, levels, evidence.equations.by_record, strict=True)
            updates = [_acting_as_before(*triple) for triple in triples]
        change = [_log_levels(new) - _log_levels(old) for new, old in zip(updates, levels, strict=True)]
        strides = list(map(_stride, before, change))
        moves = zip(levels, strides, floors, strict=True)
        noise_of_records = (
            replace(_moved(*move), taken_up=new.taken_up) for move, new in zip(moves, updates, strict=True)
        )
        roughness = rougher_or_smoother(evidence, trained)
        shared = replace(trained.noise, spread=evidence.learned_spread(trained), roughness=roughness)
        noise = replace(shared, records=tuple(noise_of_records))
        rougher = np.log(roughness / evidence.equations.roughness(trained.noise))
        moved = [*np.concatenate(strides), np.log(noise.spread / trained.noise.spread), *rougher]
        again = evidence.train(noise, trained.solution.point, goes_on=bool(np.abs(moved).max() < NEAR_LEVEL))
        # One that is still on its way is followed as long as it is the more probable one already.
        if again is None or not (again.solution.converged or again.log_evidence > trained.log_evidence):
            break
        before = list(change)
        gain, trained = again.log_evidence - trained.log_evidence, again
        idle = 0 if trained.log_evidence > best.log_evidence + NEGLIGIBLE_GAIN else idle + 1
        best = max(best, trained, key=lambda trained: trained.log_evidence)
        losing = losing + 1 if trained.log_evidence < best.log_evidence - LOST else 0
        if losing == LOSING or idle == IDLE:
            break
        if np.abs(np.concatenate([*change, rougher])).max(initial=0.0) < SETTLED or abs(gain) < NEGLIGIBLE_GAIN:
            break
    return _with_its_spread(evidence, best)


def _acting_as_before(new: NoiseModel, old: NoiseModel, equations: NormalEquations) -> NoiseModel:
    """The same, but for forces that nobody measured and what the model leaves out.

    The density that moves held parameters says how large these are.
    """
    new, forces = replace(new, discrepancy=old.discrepancy), equations.dynamics.forces
    return new if old.innovation is None else new.driven_by(old.innovation[forces], forces)


def _with_its_spread(evidence: Evidence, trained: Trained) -> Trained:
    """The same under the spread of the parameters that it asks for, if that is more probable.

    Where a round of all levels together is less probable for one of them, none moves, and the spread is still that of a
    solution long before.
    """
    spread = evidence.learned_spread(trained)
    if abs(np.log(spread / trained.noise.spread)) < SETTLED:
        return trained
    again = evidence.train(replace(trained.noise, spread=spread), trained.solution.point)
    return trained if again is None else max(trained, again, key=lambda trained: trained.log_evidence)


def rougher_or_smoother(evidence: Evidence, trained: Trained) -> np.ndarray:
    """(curves,), most probable prior deviations of the terms of each, over those given: s^2 = sum x^2 / gamma.

    Up to those; of a curve that the record hardly tells as if it told one term.
    """
    curve, before = evidence.equations.curve, evidence.equations.roughness(trained.noise)
    terms, count = curve >= 0, len(before)
    x, of = trained.solution.point.parameters.numpy()[terms], curve[terms]
    left_open = np.diag(trained.factor.corner_covariance)[terms] / before[of] ** 2
    told = np.bincount(of, (1.0 - left_open).clip(min=0.0), count)
    now = np.sqrt(np.bincount(of, x**2, count) / np.maximum(told, 1.0))
    found: np.ndarray = np.clip(now, before / LARGEST_CHANGE, np.minimum(before * LARGEST_CHANGE, 1.0))
    return found


def values_taken(evidence: RecordEvidence, solution: RecordSolution) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """How many values a solution has taken up: by name of channels (channels,), and (functions,) of the equations.

    They are effective numbers of parameters, gamma, by draws. Each draw from the posterior gives all of them at once,
    and scaled to the length that a draw has on average, they add up to what they must; a few draws tell each to some
    per cent.
    """
    equations, noise, point = evidence.equations, solution.noise, solution.point
    draws = solution.drawn(DRAWS, of_mean_length=True)
    response = {
        channels.name: channels.squares_moved(point, draws) / DRAWS / noise.response[channels.name] ** 2
        for channels in equations.channels
    }
    physics, enforced = equations.motion.weight(noise), np.zeros(equations.dynamics.size)
    for part, forces in equations.motion.moved(point, draws):
        weight = physics if physics.ndim == 1 else physics[part]
        for force in forces:
            enforced += (force.square() * weight).sum((0, 1)).numpy() / DRAWS
    return response, enforced


def updated(evidence: RecordEvidence, solution: RecordSolution, least: NoiseModel) -> NoiseModel:
    """The noise levels that the residuals ask for, none below its floor; those that repeats tell stay."""
    equations, noise = evidence.equations, solution.noise
    taken, of_physics = values_taken(evidence, solution)
    force, discrepancy, innovation = _forces(evidence, solution, of_physics)
    discrepancy = max(float(_limited(discrepancy, noise.discrepancy)), least.discrepancy)
    if noise.innovation is not None:
        noise = replace(noise, innovation=_limited(innovation, noise.innovation))
    if equations.problem.record.repeats is not None:
        return replace(noise, discrepancy=discrepancy)
    response, under_forces = dict(noise.response), equations.problem.inputs.unmeasured
    usual_levels = _usual_levels(evidence, noise)
    for channels in equations.channels:
        name, samples, square = channels.name, channels.samples, channels.squares(solution.point)
        freedom = np.maximum(samples - taken[name], FEWEST_LEFT * samples)
        usual, share = usual_levels[name], np.clip(taken[name] / samples, 0.0, 1.0)
        weight = samples * (KINSHIP_UNDER_FORCES if under_forces else KINSHIP * share**OPENNESS)
        variance = np.where(usual > 0, (square + weight * usual**2) / (freedom + weight), square / freedom)
        level = _limited(np.sqrt(variance), noise.response[name])
        response[name] = np.where(channels.present, np.maximum(level, least.response[name]), noise.response[name])
    for (name, i), sensor in evidence.input_channels.items():
        response[name][i] = min(response[name][i], max(sensor.loudest, least.response[name][i]))
    noise = replace(noise, taken_up=taken.get(CALIBRATED))
    most = np.full(len(force), np.inf)
    for dof, cell in evidence.load_cells.items():
        most[dof] = max(cell.loudest, least.force[dof])
    force = np.clip(_limited(force, noise.force), least.force, most)
    return replace(noise, response=response, force=force, discrepancy=discrepancy)


def _usual_levels(evidence: RecordEvidence, noise: NoiseModel) -> dict[str, np.ndarray]:
    """Name to the noise that each sensor would have if the record left it open; 0 where nothing is known.

    What its spectrum shows above its band, or as much as others of its kind. A lone accelerometer beside a load cell,
    whose spectrum shows nothing: what its emptiest part has at most, or see `BESIDE_LOAD_CELL`.
    """
    equations = evidence.equations
    sensors = evidence.sensors
    cells: dict[int, tuple[SensorSamples, float]] = {}
    cells |= {dof: (cell, noise.force[dof]) for dof, cell in evidence.load_cells.items()}
    of_columns = {at: cell for at, cell in evidence.load_cell_channels.items() if cell.channel.is_column}
    cells |= {cell.channel.dof: (cell, noise.response[q][i]) for (q, i), cell in of_columns.items()}
    relative: defaultdict[str, dict[tuple[str, int], float]] = defaultdict(dict)
    for (name, i), sensor in sensors.items():
        if sensor.rms > 0:
            relative[sensor.channel.quantity][name, i] = noise.response[name][i] / sensor.rms
    out = {channels.name: np.zeros(len(channels.present)) for channels in equations.channels}
    for (name, i), sensor in sensors.items():
        kin, channel = relative[sensor.channel.quantity], sensor.channel
        if sensor.shown:
            out[name][i] = sensor.shown
        elif kin.keys() - {(name, i)}:
            out[name][i] = sensor.rms * np.median([level for key, level in kin.items() if key != (name, i)])
        elif channel.quantity == "acceleration" and channel.is_column and channel.dof in cells:
            mass, (cell, level) = float(equations.prescribed["m"][channel.dof]), cells[channel.dof]
            if level > 0 and mass > 0:
                out[name][i] = min(sensor.most, BESIDE_LOAD_CELL * cell.most / mass)
    return {name: np.nan_to_num(level, posinf=0.0) for name, level in out.items()}


def _forces(
    evidence: RecordEvidence, solution: RecordSolution, taken: np.ndarray
) -> tuple[np.ndarray, float, np.ndarray]:
    """(functions,) force sensors' noise, the discrepancy, and (functions,) what drives unknown forces."""
    noise = solution.noise
    split = evidence.force_residuals(solution.point, noise)
    freedom = np.maximum(split.count - taken, FEWEST_LEFT * split.count)
    variance, enforced = noise.physics_variance, split.enforced & ~noise.driven
    misfit = (split.seen / variance)[enforced]
    share = (noise.discrepancy**2 / variance)[enforced]
    discrepancy = noise.discrepancy
    if enforced.any():
        discrepancy *= float(np.sqrt((share * misfit).sum() / (share * freedom[enforced]).sum()))
    squares, values = _of_force_sensors(noise, split, freedom)
    with np.errstate(divide="ignore", invalid="ignore"):
        innovation = _innovation(evidence, solution, split.seen, freedom)
        return noise.force * np.sqrt(squares / values), discrepancy, innovation


def _of_force_sensors(noise: NoiseModel, split: ForceResiduals, freedom: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(functions,) squares over the present variance, and values, of the force sensors' noise; 0 of all others.

    Of what the features see, so many values (functions,) are free: the solution has not taken them up.
    """
    variance, sensor = noise.physics_variance, noise.force_variance
    sensor_share = 1.0 - noise.discrepancy**2 / variance
    with np.errstate(divide="ignore", invalid="ignore"):
        beyond = split.unseen / sensor if split.beyond else np.zeros(len(sensor))
    return sensor_share * split.seen / variance + beyond, sensor_share * freedom + split.beyond


def force_noise_statistics(evidence: RecordEvidence, solution: RecordSolution) -> tuple[float, float]:
    """Squares over variance of all force sensors of one record, repeats included, and how many values they are.

    The most probable noise is that of the solution times the root of their ratio, with a relative standard deviation of
    1 / sqrt(2 values) (MacKay 1992). A sensor at its floor stays there.
    """
    noise, record, least = solution.noise, evidence.equations.problem.record, floor(evidence, solution)
    sensors = np.flatnonzero(noise.force_variance > 0.0)
    split = evidence.force_residuals(solution.point, noise)
    freedom = split.count - values_taken(evidence, solution)[1]
    squares, values = _of_force_sensors(noise, split, np.maximum(freedom, FEWEST_LEFT * split.count))
    squares = np.maximum(squares, values * (least.force / noise.force) ** 2)[sensors]
    totals = float(squares.sum()), float(values[sensors].sum())
    if record.repeats is None or not sensors.size:
        return totals
    scatter = record.repeats.square[FORCE][sensors] / (record.repeats.count * noise.force[sensors] ** 2)
    return totals[0] + float(scatter.sum()), totals[1] + record.repeats.freedom * sensors.size


def _innovation(
    evidence: RecordEvidence, solution: RecordSolution, seen: np.ndarray, freedom: np.ndarray
) -> np.ndarray:
    """(functions,) standard deviation of what drives the ground and unknown forces, NaN of all others."""
    equations, level = evidence.equations, np.full(len(seen), np.nan)
    dynamics, nyquist = equations.dynamics, 0.5 / equations.problem.record.step
    for i in range(dynamics.smooth.start, dynamics.smooth.stop):
        level[i] = np.sqrt(seen[i] / freedom[i])
        if equations.network.free_intervals > 2.0 * nyquist:  # beyond, an input is told to be nothing
            drive = drive_below(evidence, solution, slice(i, i + 1), nyquist)
            level[i] = level[i] if drive is None or drive.levels is None else drive.levels[0]
    if dynamics.inputs.unmeasured:
        level[dynamics.forces] = levels_of_a_kind(seen[dynamics.forces], freedom[dynamics.forces])
    return level


def floor(evidence: RecordEvidence, solution: RecordSolution) -> NoiseModel:
    """The least levels that are looked for."""
    noise, of_force = solution.noise, np.full(len(solution.noise.force), np.nan)
    for dof, cell in evidence.load_cells.items():
        of_force[dof] = max(cell.finest, cell.shown)
    cells = [*evidence.load_cells.values(), *evidence.load_cell_channels.values()]
    per_force = evidence.problem.structure.shapes.scale
    force = max((per_force * cell.rms for cell in cells), default=noise.discrepancy)
    finest_of_inputs = negligible(evidence.equations, noise)
    discrepancy = max(min(FINEST_KNOWN * force, noise.discrepancy), finest_of_inputs)
    response = dict(noise.response)
    for channels in evidence.equations.channels:
        # The sensor of an input has at least the noise that its spectrum shows. Where the motion does not tell a load
        # cell's, none at all would do as well; and the ground, which may move alike at all frequencies, takes noise
        # for it.
        finest = np.fmin(channels.numbers("finest"), noise.response[channels.name])
        response[channels.name] = np.fmax(finest, channels.acting * channels.numbers("shown"))
    return replace(noise, response=response, force=of_force, discrepancy=discrepancy)


def _limited(level: np.ndarray | float, before: np.ndarray | float) -> np.ndarray:
    """A standard deviation that has changed by no more than a factor."""
    return np.clip(level, np.divide(before, LARGEST_CHANGE), np.multiply(before, LARGEST_CHANGE))


def _log_levels(noise: NoiseModel) -> np.ndarray:
    """Logarithms of all standard deviations; 0 where there is no sensor, or none that is not known to be perfect."""
    innovation = np.full(len(noise.force), np.nan) if noise.innovation is None else noise.innovation
    levels = np.concatenate([*noise.response.values(), noise.force, innovation, [noise.discrepancy]])
    return np.log(np.where(np.isfinite(levels) & (levels > 0), levels, 1.0))


def _moved(noise: NoiseModel, change: np.ndarray, least: NoiseModel) -> NoiseModel:
    """The levels times exp of a change, in the order of :func:`_log_levels`."""
    sizes = [*(len(level) for level in noise.response.values()), len(noise.force)]
    *parts, of_force, of_innovation = np.split(np.exp(change[:-1]), np.cumsum(sizes))
    response = {
        q: np.maximum(level * part, least.response[q])
        for (q, level), part in zip(noise.response.items(), parts, strict=True)
    }
    force = np.maximum(noise.force * of_force, least.force)
    discrepancy = max(noise.discrepancy * float(np.exp(change[-1])), least.discrepancy)
    innovation = None if noise.innovation is None else noise.innovation * of_innovation
    return replace(noise, response=response, force=force, discrepancy=discrepancy, innovation=innovation)


def _stride(before: np.ndarray | None, change: np.ndarray) -> np.ndarray:
    """A change, lengthened where it shrinks by a steady ratio from round to round (Aitken)."""
    if before is None:
        return change
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.nan_to_num(change / before)
    steady = (ratio > 0.0) & (ratio < 1.0)
    stride = np.where(steady, np.minimum(1.0 / (1.0 - np.where(steady, ratio, 0.0)), LONGEST_STRIDE), 1.0)
    return np.clip(change * stride, -np.log(LARGEST_CHANGE), np.log(LARGEST_CHANGE))
