"""The verdict on a run: sound, questionable or failed, and why. It sees record, problem and estimate, never the truth.

Two layers. The numbers of the estimate say that something is wrong. Causes say what: a fault is named where mending it
makes a structure, the estimated or the prescribed one, do under the measured force what every sensor measured.

Records that contradict each other: several that were solved together, or one and those before it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.channels import channels
from pinn_cli.scheme.joint_problem import unreached_dofs
from pinn_cli.system.coupling import loose_dofs
from pinn_cli.system.parameters import MASS
from pinn_cli.training.calibrated_record import as_run
from pinn_cli.training.estimate import estimated_structure
from pinn_cli.training.reported.stories import explain_most
from pinn_cli.verdict.causes import NEEDS_NO_CAUSE
from pinn_cli.verdict.causes import causes as fitted_causes
from pinn_cli.verdict.channel_faults import LEAST_GAIN_FAULT, channel_faults, first_sample_findings, record_faults
from pinn_cli.verdict.finding import Finding, Verdict
from pinn_cli.verdict.input_findings import input_findings, resonance_findings, sampling_findings
from pinn_cli.verdict.parameter_findings import (
    APART,
    LEAST_APART,
    baseline_findings,
    doubt_findings,
    parameter_findings,
)
from pinn_cli.verdict.prediction import predicted, prediction_of, worst_misfit
from pinn_cli.verdict.sensor_findings import NOT_AT_ALL, noise_findings, sensor_findings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pinn_cli.record.response import Response
    from pinn_cli.scheme.problem import Problem
    from pinn_cli.system.structure import Structure
    from pinn_cli.training.estimate import Estimate


CAUSES_NAMED = 3
# Probabilities below it are all the same.
LEAST_TOLD = 1e-12
# Doubts that the causes of this folder size better where they are large.
TOLD_BY_CAUSES = (MASS, "gain", "delay")
# Share of what a model leaves out from which on a doubt is the cause of whatever else is wrong.
MOST_EXPLAINED = 0.5
# NMSE of every sensor up to which a free run calls for no cause.
PREDICTED_WELL = 0.02


def contradictions(estimate: Estimate) -> list[Finding]:
    """A finding for the record that is farthest from the others, if it pulls at the parameters beyond chance."""
    together = {p.name: p.estimate for p in estimate.parameters}
    contradicting = []
    for number, disagreement in enumerate(estimate.disagreements, start=1):
        off = {name: value / together[name] - 1.0 for name, value in disagreement.alone.items() if together.get(name)}
        far = sorted((name for name in off if abs(off[name]) > LEAST_APART), key=lambda name: -abs(off[name]))
        if disagreement.square > APART**2 * disagreement.freedom and far:
            contradicting.append((abs(off[far[0]]), number, far[:CAUSES_NAMED]))
    if not contradicting:
        return []
    _, number, names = max(contradicting)
    alone = estimate.disagreements[number - 1].alone
    named = ", ".join(f"{name} = {alone[name]:.4g} (all together: {together[name]:.4g})" for name in names)
    others = "the other one" if len(estimate.disagreements) == 2 else "the others"
    remedy = "check its units, gains and DOFs, whether the structure had changed, and the model; or leave it out"
    text = f"record {number} contradicts {others}: by itself it says {named}; {remedy}"
    return [Finding("contradiction", f"record {number}", text)]


def verdict_of_records(by_record: Sequence[Verdict | None], among: Sequence[Finding] = ()) -> Verdict | None:
    """The worst of all; what every record says in the same words, as of the parameters, is told once.

    ``among`` is what records say of each other, and what is said of all.
    """
    verdicts = [verdict for verdict in by_record if verdict is not None]
    if len(verdicts) < 2:
        return Verdict.of([*verdicts[0].reasons, *among]) if verdicts else None
    common = set.intersection(*({finding.text for finding in verdict.reasons} for verdict in verdicts))
    findings = [*among, *(finding for finding in verdicts[0].reasons if finding.text in common)]
    for number, verdict in enumerate(verdicts, start=1):
        name = f"record {number}: "
        own = (finding for finding in verdict.reasons if finding.text not in common)
        findings += [replace(one, suspect=name + one.suspect, text=name + one.text) for one in own]
    return Verdict.of(findings)


def change_findings(estimate: Estimate) -> list[Finding]:
    """Where what changed, nothing perhaps, leaves more of a contradiction than chance does; where much changed at once.

    A sensor whose gain is another one now looks like several parameters that changed: a twentieth of one gain was seen
    to be three stiffnesses and a damping.
    """
    changes = estimate.changes
    if changes is None:
        return []
    findings, names = [], ", ".join(change.parameter.name for change in changes.found)
    if changes.chance < changes.improbable:
        remedy = "check units, gains and DOFs of its channels; if the structure is another one now, identify it anew"
        beyond = f"beyond what changes of {names} explain" if names else "and no one parameter explains it"
        chance = f"by chance {changes.chance:.1g}" if changes.chance >= LEAST_TOLD else f"by chance below {LEAST_TOLD}"
        text = f"the record contradicts the earlier ones {beyond} ({chance}); {remedy}"
        findings.append(Finding("contradiction", "record", text))
    if len(changes.found) > 1:
        remedy = "check the channels, or learn their gains along (data.channels)"
        text = f"{names} changed at once; a sensor whose gain changed looks like that as well: {remedy}"
        findings.append(Finding("changes", names, text))
    return findings


def judge(
    problem: Problem,
    estimate: Estimate,
    baseline: Estimate | None = None,
    free_run: Response | None = None,
    contradicted: float = math.nan,
) -> Verdict:
    """Judge a problem's solution, beside another estimator's where there is one.

    Args:
        problem: That was solved.
        estimate: Its solution.
        baseline: Another estimator's.
        free_run: The estimated structure's response to the measured force, where the caller has it already.
        contradicted: Its agreement with the estimated displacements where noise and the start do not explain how far it
            is off, %; NaN elsewhere.
    """
    record, structure = problem.record, estimated_structure(problem.structure, estimate.parameters)
    # Of some sensors the model can say nothing: whatever they show is no fault of theirs, nor of any other sensor.
    dofs = unreached_dofs(problem)
    text = "cannot be explained: no force of the model reaches that sensor; add the connection that is missing, or the"
    unreached = [
        Finding("unreached", channel.name, f"the {channel.name} {text} force there (data.force)")
        for channel in channels(record)
        if channel.dof in dofs
    ]
    carried = np.flatnonzero(structure.shapes.matrix[:, loose_dofs(structure)].any(axis=1)).tolist()
    faults = record_faults(record, carried) + unreached + first_sample_findings(record, estimate)
    excused = [finding.suspect for finding in faults]
    run = as_run(record, estimate)
    if free_run is None:
        prediction = predicted(structure, run, estimate.response.state(0))
    else:
        prediction = prediction_of(structure, run, free_run)
    findings = sensor_findings(problem, estimate, prediction) + noise_findings(problem, estimate)
    findings += parameter_findings(problem, estimate, structure) + baseline_findings(estimate, baseline, problem.record)
    findings += change_findings(estimate) + input_findings(problem, estimate, structure)
    findings += sampling_findings(problem, estimate, structure)
    if problem.identifies and not math.isnan(contradicted) and not any(f.kind == "free_run" for f in findings):
        text = (
            f"a free run with the estimated parameters agrees with the estimated displacements to"
            f" {max(contradicted, 0):.0f} % only: the model, a sensor's scale or the parameters are wrong"
        )
        remedy = "do not trust displacements and parameters together"
        findings.append(Finding("contradicted", "parameters", f"{text}; {remedy}"))
    # A free run that follows the sensors has their resonances.
    misfit = worst_misfit(prediction, excused)
    follows_well = misfit <= PREDICTED_WELL
    missed = resonance_findings(problem, structure) if not follows_well and problem.spectral is None else []
    lacks, is_sound = doubt_findings(estimate), all(finding.word == "sound" for finding in findings + missed)
    lacks_something = bool(lacks) and lacks[0].kind not in TOLD_BY_CAUSES
    # Where the free run follows the sensors, a filter, a tilt or a law that is shown to be lacking is the cause. Wide
    # deviations of the parameters may excuse whatever it misses: then a cause of this folder goes before, if any.
    follows = all(finding.kind != "free_run" and finding.word != "failed" for finding in findings)
    causes = lacks if lacks_something and follows and (prediction is None or misfit <= NOT_AT_ALL) else []
    # What explains little of what is left out may stand in for a mass or a sensor of which spectra tell.
    is_little = any(finding.word != "sound" for finding in lacks) and not explain_most(estimate.doubts)
    if is_little or (not causes and not is_sound and not follows_well):
        needs_no_cause = 0.0 if is_little else NEEDS_NO_CAUSE
        fitted = fitted_causes(problem, _believed(problem, estimate), structure, excused, needs_no_cause)
        causes = [*fitted, *(lacks if is_little else [])] if fitted else causes
    # Elsewhere it is what explains most of what the model leaves out, or wrong damping; and whatever is small, of which
    # the estimated structure, held fixed, says less than one whose parameters are free.
    explains = lacks_something and (lacks[0].kind == "damping" or estimate.doubts[0].share > MOST_EXPLAINED)
    if not causes and (explains or follows_well or (lacks_something and follows)):
        causes = lacks
    if not causes and prediction is not None:
        # That it is a sensor, and no more, says nothing beside deviations that allow as much.
        unexplained = [finding.suspect for finding in findings if finding.kind == "free_run"]
        faults_of_one = channel_faults(prediction, excused)
        causes = [finding for finding in faults_of_one if finding.kind != "sensor" or finding.suspect in unexplained]
    moved = [abs(p.estimate - p.prescribed) / abs(p.prescribed) for p in estimate.parameters if p.prescribed]
    if not causes and not problem.identifies and max(moved, default=0.0) > LEAST_GAIN_FAULT / 4:
        # A gain that believed parameters have made up for shows against the prescribed ones.
        prescribed = predicted(_believed(problem, estimate), record)
        causes = [] if prescribed is None else channel_faults(prescribed, excused)
    # A fault that is named draws everything along.
    return Verdict.of(faults + (causes or ([] if faults else lacks)) + findings + missed)


def _believed(problem: Problem, estimate: Estimate) -> Structure:
    """What is prescribed, and the estimates of what is unknown or has changed: a start is nobody's belief."""
    changed = [change.parameter for change in estimate.changes.found] if estimate.changes else []
    now = [p for p in estimate.parameters if p.unknown or p.parameter in changed]
    return estimated_structure(problem.structure, now)
