"""Sensors that the estimated structure, left to itself under the measured force, does not reproduce.

What the inferred levels and the residuals say of an estimate: nothing explained, not white, a large discrepancy.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.channel import CALIBRATED, Channel
from pinn_cli.record.channels import FINEST_KNOWN, channels, every_channel
from pinn_cli.record.free_run import is_linear
from pinn_cli.record.inputs import input_force
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.record.spectrum import usable_periodogram
from pinn_cli.system.quantities import FORCE, GROUND, SUPPORT
from pinn_cli.training.estimate import estimated_structure
from pinn_cli.verdict.finding import Finding, failed_if
from pinn_cli.verdict.prediction import Comparison, comparisons, predicted

if TYPE_CHECKING:
    import pandas as pd

    from pinn_cli.record.record import Record
    from pinn_cli.scheme.problem import Problem
    from pinn_cli.system.structure import Structure
    from pinn_cli.training.estimate import Estimate
    from pinn_cli.verdict.prediction import Prediction


# NMSE of a free run that needs no excuse, and how many times the excuses' sum it may be: a few draws tell a mean
# square to within a factor of two or so. At half, nothing is reproduced.
GOOD, ALLOWED, NOT_AT_ALL = 0.05, 4.0, 0.5
# Draws; and of what is not linear: where the motion is chaotic, or nearly so, few of many part from it.
EXCUSE_DRAWS, NONLINEAR_EXCUSE_DRAWS = 2, 16
# A sensor with 10 dB of noise has a third of its rms; at this share there is more noise than motion.
MOSTLY_NOISE = 0.8
# Rms of the discrepancy over that of the measured force. A linear model of a Duffing chain has a tenth.
LARGE_DISCREPANCY, AS_LARGE_AS_FORCE = 0.2, 0.7
# NMSE of a free run up to which a model is nearly right, however large the force that it leaves out: off resonance a
# small change of the motion takes a large force.
NEARLY_PREDICTED = 0.05
# A white residual's power in one of so many bands is within a factor of two of their median's. The coloured part
# counts where it is this share of the channel's own power: a gain 7 % off leaves it.
BANDS, COLOURED, COLOURED_SHARE = 24, 5.0, 0.005
# Effective parameters over samples of all channels: from here on they are copied rather than estimated.
COPIED = 0.9
NOT_CONVERGED = "iteration limit"
# A loss that falls by this part in an eighth of a stage of training has some way to go; rows that tell of it.
STILL_FALLS, FEWEST_ROWS = 0.05, 6


def sensor_findings(problem: Problem, estimate: Estimate, prediction: Prediction | None) -> list[Finding]:
    """Channels whose NMSE is larger than sensor noise, the force's noise and the parameters' deviations allow.

    No prediction, of the estimated structure, is a finding where every force is known: it is unstable or too stiff. Of
    a model that holds within noise that may be a contact that turns round too sharply to be followed.
    """
    if prediction is None:
        if problem.record.unmeasured:
            return []
        text = "the estimated structure is unstable or too stiff for a free run; check units, masses and the time axis"
        return [Finding("free_run", "model", text, failed_if(not _holds_within_noise(problem, estimate)))]
    compared = comparisons(prediction)
    # The noise's share of a mean square; what is called noise for half of the sensor or more is no excuse.
    shares = {c.channel.name: estimate.noise.of(c.channel) ** 2 / c.power for c in compared}
    excuse = {name: share if share < 0.25 else 0.0 for name, share in shares.items()}
    bad = [c for c in compared if c.misfit > max(GOOD, ALLOWED * excuse[c.channel.name])]
    findings = []
    for c in _unexplained(problem, estimate, prediction, bad, excuse):
        text = f"the free run does not reproduce the {c.channel.name}: NMSE {c.misfit:.2g}"
        word, remedy = failed_if(c.misfit > NOT_AT_ALL), "check that sensor and the parameters near it"
        findings.append(Finding("free_run", c.channel.name, f"{text}; {remedy}", word))
    return findings


def _unexplained(
    problem: Problem, estimate: Estimate, prediction: Prediction, bad: Sequence[Comparison], noise: Mapping[str, float]
) -> Sequence[Comparison]:
    """Those that are worse than their noise, that of the inputs and the deviations of parameters and start allow.

    Draws tell what the latter do: a channel may be so many times as far off as their mean, and as far as any of them.
    """
    random = np.random.default_rng(0)
    start, spread = estimate.response.state(0), estimate.state_std(problem.structure, 0)
    inputs = channels(prediction.record, [FORCE, GROUND, *SUPPORT])
    levels = np.nan_to_num([estimate.noise.of(sensor) for sensor in inputs], posinf=0.0)
    drawn: dict[str, list[float]] = {c.channel.name: [] for c in bad}
    for _ in range(EXCUSE_DRAWS if is_linear(problem.structure) else NONLINEAR_EXCUSE_DRAWS):
        if not bad:
            break
        # As much noise again on every measured force, and on the motion of ground and supports.
        record = prediction.record.showing(
            replace(sensor, measured=sensor.measured + level * random.normal(size=len(prediction.record.time)))
            for sensor, level in zip(inputs, levels, strict=True)
        )
        begun = [x + std * random.normal(size=len(x)) for x, std in zip(start, spread, strict=True)]
        other = predicted(random_structure(problem, estimate, random), record, begun)
        for c in bad:
            drawn[c.channel.name].append(0.0 if other is None else _change(c, prediction, other))
        allowed = {
            name: max(ALLOWED * sum(of) / len(of), *of) + ALLOWED * noise[name] + GOOD for name, of in drawn.items()
        }
        bad = [c for c in bad if c.misfit > allowed[c.channel.name]]
    return bad


def _change(compared: Comparison, prediction: Prediction, other: Prediction) -> float:
    """How far another prediction of a channel is from one, as NMSE."""
    channel = compared.channel
    change = channel.of(other.response) - channel.of(prediction.response)[: len(other.record.time)]
    return float(np.mean(change**2)) / compared.power


def random_structure(problem: Problem, estimate: Estimate, random: np.random.Generator) -> Structure:
    """The estimated structure with every parameter off by its standard deviation at random, correlations allowed for.

    Signs are kept, but of terms of a curve: a stiffness that is known to itself has no negative values.
    """
    std = np.nan_to_num([p.std for p in estimate.parameters])
    z = random.normal(size=len(std))
    if estimate.correlation is not None and len(std):
        values, vectors = np.linalg.eigh(np.nan_to_num(estimate.correlation))
        z = vectors @ (np.sqrt(np.maximum(values, 0.0)) * z)
    moved = []
    for p, move in zip(estimate.parameters, std * z, strict=True):
        value = p.estimate + float(move)
        moved.append(replace(p, estimate=value) if value * p.estimate > 0 or p.parameter.curve else p)
    return estimated_structure(problem.structure, moved)


def noise_findings(problem: Problem, estimate: Estimate) -> list[Finding]:
    """Every finding of this page, in the order of the channels."""
    seen = every_channel(problem.record, (*RESPONSE_QUANTITIES, GROUND, *SUPPORT))
    findings = [f for c in seen for f in (*_level(c, estimate), *_colour(c, problem.record, estimate))]
    # Where a force that nobody measured acts on every DOF, or as many act as there are sensors, any motion is rightly
    # followed.
    unmeasured = problem.dynamics.forces
    free = unmeasured.stop - unmeasured.start >= min(problem.record.ndof, len(seen))
    copied = [] if free or _holds_within_noise(problem, estimate) else _copied(problem.record, estimate)
    return findings + _discrepancy(problem, estimate) + copied + _unfinished(estimate)


def _level(channel: Channel, estimate: Estimate) -> Iterator[Finding]:
    rms, level = float(np.std(channel.measured)), estimate.noise.of(channel)
    if not np.isfinite(level) or rms == 0:
        return
    if level <= 2.0 * FINEST_KNOWN * rms:  # levels are kept above that: what is found there was not found
        text = f"the noise found in the {channel.name} is at its lower bound ({level:.2g}): the record was copied"
        remedy = "use fewer knots (network.knots_per_period) or more sensors"
        yield Finding("noise_at_bound", channel.name, f"{text}; {remedy}")
    elif level >= MOSTLY_NOISE * rms:
        share = f"{100 * level / rms:.0f} % of its rms"
        text = f"the noise found in the {channel.name} is {share}: nothing of it is explained"
        yield Finding("nothing_explained", channel.name, f"{text}; check that sensor and the model", "failed")


def _colour(channel: Channel, record: Record, estimate: Estimate) -> Iterator[Finding]:
    """Whether what is left of a channel has a band of its own; only power above the median band is held against it."""
    residual = channel.measured - channel.of(estimate.response)
    if not np.isfinite(residual).all() or not np.std(channel.measured) > 0:
        return
    frequency, power = (x[1:] for x in usable_periodogram(residual, record.step))
    pieces = np.array_split(np.arange(len(power)), min(BANDS, max(1, len(power) // 8)))
    level = np.array([power[piece].mean() for piece in pieces])
    high = level > COLOURED * np.median(level)
    share = sum(power[piece].sum() for piece, is_high in zip(pieces, high, strict=True) if is_high) / power.sum()
    nmse = float(np.mean(residual**2) / np.var(channel.measured))
    if high.any() and not share * nmse < COLOURED_SHARE:
        worst = pieces[int(np.argmax(level))]
        where = f"most at {frequency[worst[0]]:.3g} to {frequency[worst[-1]]:.3g} Hz"
        text = f"the residual of the {channel.name} is not white: {100 * share:.0f} % of it is in excess, {where}"
        yield Finding("not_white", channel.name, f"{text}; check that sensor, or use a model that moves there")


def _discrepancy(problem: Problem, estimate: Estimate) -> list[Finding]:
    """Against the rms of the measured forces, together; where the ground moves, of what moves the masses with it."""
    level, record = estimate.noise.discrepancy, problem.record
    variances = list(np.var(record.force[:, record.sensors("force")], axis=0))
    if record.measured_ground is not None:
        masses = problem.structure.parameters["m"].detach().cpu().numpy()
        variances += list((masses * problem.structure.with_ground) ** 2 * np.var(record.measured_ground))
    if record.supports:
        pushed = np.var(input_force(problem.structure, record), axis=0)
        variances += list(pushed[pushed > 0.0])
    if not np.isfinite(level) or not variances:
        return []
    rms = float(np.sqrt(np.mean(variances)))
    ratio = level / rms if rms > 0 else 0.0
    if ratio < LARGE_DISCREPANCY:
        return []
    cell = np.nanmax(estimate.noise.sensors.get(FORCE, np.empty(0)), initial=0.0)
    acting = "the measured force" if record.ground_acceleration is None else "what acts"
    times_noise = f" and {level / cell:.3g} times the load cell's noise" if cell > 0 else ""
    text = f"the discrepancy of the model is {100 * ratio:.0f} % of {acting}{times_noise}"
    remedy = "the model does not hold; check masses, units and the law of the springs"
    # Of a free run that predicts the sensors nearly all is right.
    predicts = bool(estimate.stories) and estimate.stories[0].free_run < 100.0 * NEARLY_PREDICTED
    word = failed_if(ratio >= AS_LARGE_AS_FORCE and not predicts)
    return [Finding("discrepancy", "model", f"{text}: {remedy}", word)]


def _holds_within_noise(problem: Problem, estimate: Estimate) -> bool:
    """Whether the model is off by less than any measured input: then it is their noise that leaves the motion open."""
    sensors = estimate.noise.sensors
    noise = sensors.get(FORCE, np.empty(0))
    if problem.record.ground_acceleration is not None:
        moved = problem.structure.parameters["m"].detach().cpu().numpy() * problem.structure.with_ground
        noise = np.concatenate((noise, *(abs(moved) * level for level in sensors.get(GROUND, ()))))
    noise = noise[noise > 0.0]
    return bool(noise.size) and estimate.noise.discrepancy < float(noise.min())


def _copied(record: Record, estimate: Estimate) -> list[Finding]:
    """As many effective parameters as samples, over all response sensors.

    One accelerometer beside a poor load cell is rightly followed wherever it goes; all of them are not.
    """
    taken = estimate.noise.taken
    counts = [(count, len(record.time)) for q in RESPONSE_QUANTITIES for count in taken.get(q, ())]
    counts += [
        (count, len(channel.time))
        for channel, count in zip(record.calibrated, taken.get(CALIBRATED, ()), strict=False)
        if channel.quantity in RESPONSE_QUANTITIES
    ]
    followed, samples = np.sum([pair for pair in counts if np.isfinite(pair[0])] or [(0, 1)], axis=0)
    if followed < COPIED * samples:
        return []
    text = f"{followed:.0f} effective parameters follow the {samples:.0f} samples of all response sensors"
    remedy = "they were copied; check the model, or use fewer knots (network.knots_per_period)"
    return [Finding("copied", "sensors", f"{text}: {remedy}")]


def _unfinished(estimate: Estimate) -> list[Finding]:
    """Trainings by gradients, which have no standard deviations, all end at their limit: some while the loss falls."""
    if estimate.summary.get("stop_reason") != NOT_CONVERGED:
        return []
    text = "the training stopped at its iteration limit"
    if np.isnan(estimate.std.displacement).all():
        fall = _fall(estimate.history)
        if fall < STILL_FALLS:
            return []
        text += "" if np.isnan(fall) else f" while its loss was falling, by {fall:.0%} in its last eighth"
    return [Finding("not_converged", "training", f"{text}; raise training.iterations")]


def _fall(history: pd.DataFrame) -> float:
    """By which part a loss falls in an eighth of the rows that have its last weights, as its last quarters have it.

    NaN where there are too few rows to tell.
    """
    losses = (str(name).removeprefix("loss_") for name in history)
    names = [name for name in losses if f"weight_{name}" in history]
    terms, weights = (history[[f"{kind}_{name}" for name in names]].to_numpy() for kind in ("loss", "weight"))
    loss = np.nansum(terms * weights, axis=1)[(weights == weights[-1:]).all(axis=1)]
    quarter = -(-len(loss) // 4)
    if len(loss) < FEWEST_ROWS or not (loss > 0.0).all():
        return np.nan
    return 1.0 - float(np.median(loss[-quarter:]) / np.median(loss[-2 * quarter : -quarter])) ** 0.5
