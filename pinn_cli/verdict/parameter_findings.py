"""What the estimated parameters say of an estimate: far from where they were believed, not determined, out of band.

And where an estimate and the baseline's differ by more than their standard deviations allow, or where draws of a
posterior failed their quality check.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.system.connection.nonlinearity import OVER
from pinn_cli.system.coupling import loose_dofs
from pinn_cli.system.modes import modes_of
from pinn_cli.training.estimated_structure import sought_laws
from pinn_cli.verdict.finding import Finding, failed_if

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from pinn_cli.posterior.posterior import PosteriorResult
    from pinn_cli.record.record import Record
    from pinn_cli.scheme.problem import Problem
    from pinn_cli.system.structure import Structure
    from pinn_cli.training.estimate import Estimate, ParameterEstimate

# Prior standard deviations that a parameter may move: one in 16 000 moves further by chance.
MOST_MOVED = 4.0
# What a user says of an unknown parameter is a guess, often a decade off. One and a half decades are no guess any more,
# and three are another unit.
GUESS_DECADES, UNIT_DECADES = 1.5, 2.5
# The common spread of the prescribed parameters, in units of what was believed.
LARGE_SPREAD = 4.0
# Standard deviation over value up to which an unknown stiffness or mass counts as identified, and any other parameter:
# damping and nonlinearity show less in a record, and are asked for less closely.
IDENTIFIED, ROUGHLY_IDENTIFIED = 0.1, 0.5
PARAMETERS_NAMED = 4
# Span of a law over what occurs.
SPARE = 1.1
# Times that finer features may narrow a deviation: what coarser ones cannot follow of a motion is noise to them.
NARROWED = 2.0
# Standard deviations of a difference from a baseline, or of a record from all together, and the least one worth a word,
# relative.
APART, LEAST_APART, LEAST_RESPONSE_APART = 5.0, 0.02, 0.1


def parameter_findings(problem: Problem, estimate: Estimate, structure: Structure) -> list[Finding]:
    """Every finding of this page.

    Args:
        problem: For the record and for which parameters were unknown.
        estimate: Whose parameters are judged.
        structure: With the estimated parameters.
    """
    kinds = {p.name: p.kind for p in problem.uncertain}
    unknown = [p for p in estimate.before_any_record if p.unknown]
    believed = [p for p in estimate.parameters if not p.unknown]
    of_each = (f for p in unknown for f in (_far_from_believed(p), _undetermined(p, kinds.get(p.name, ""))))
    findings = [f for f in of_each if f is not None]
    return (
        _spans(structure, estimate, {f.suspect for f in findings if f.kind == "not_identified"})
        + findings
        + _narrowed(estimate)
        + _beyond_bounds(estimate)
        + _rivals(estimate)
        + _moved(believed)
        + _spread(estimate)
        + _frequencies(structure, problem.record, loose_dofs(problem.structure))
    )


def _far_from_believed(p: ParameterEstimate) -> Finding | None:
    """Of what may have either sign in prior standard deviations; of all else in decades from what the user says.

    Where nothing is said, the record or the program chose the start: that is nobody's belief.
    """
    said = p.parameter.said
    if said > 0 and p.estimate > 0 and not p.parameter.signed:
        decades = math.log10(p.estimate / said)
        if abs(decades) <= GUESS_DECADES:
            return None
        where = "above" if decades > 0 else "below"
        text = f"{p.name} = {p.estimate:.4g} lies {abs(decades):.1f} decades {where} what you say of it, {said:.4g}"
        return Finding("parameter", p.name, f"{text}; check units and masses", failed_if(abs(decades) > UNIT_DECADES))
    if p.parameter.positive:
        return None
    if p.prior_std > 0 and abs(p.estimate - p.prescribed) > MOST_MOVED * p.prior_std:
        text = f"{p.name} = {p.estimate:.4g} is more than {MOST_MOVED:.0f} prior standard deviations from its start"
        return Finding("parameter", p.name, f"{text}; start elsewhere (scheme.initial.{p.name})")
    return None


def _undetermined(p: ParameterEstimate, kind: str) -> Finding | None:
    """Beside its value; of what may as well be zero, beside its order of magnitude where that is larger."""
    if not np.isfinite(p.std):
        return None
    value, size = abs(p.estimate), p.parameter.magnitude if p.parameter.may_vanish else 0.0
    if value <= 1e-9 * max(abs(p.prescribed), p.std) and size == 0.0:
        if p.held:
            text = f"the record does not determine {p.name}: it is held at its bound, and below {p.upper_90:.3g} (95 %)"
            return Finding("not_identified", p.name, f"{text}; prescribe it, or measure nearer to it")
        text = f"{p.name} ended at zero"
        return Finding("parameter", p.name, f"{text}; check the model, or start elsewhere (scheme.initial.{p.name})")
    allowed = IDENTIFIED if kind in ("m", "k") else ROUGHLY_IDENTIFIED
    if p.std <= max(allowed * value, IDENTIFIED * size):
        return None
    of = "its value" if value >= size else f"its order of magnitude, {size:.3g}"
    text = f"the record does not determine {p.name}: its standard deviation is {100 * p.std / max(value, size):.0f} %"
    return Finding("not_identified", p.name, f"{text} of {of}; prescribe it, or measure nearer to it")


def _beyond_bounds(estimate: Estimate) -> list[Finding]:
    """Bounds that the record contradicts: without them the parameter would be far beyond; the furthest is named.

    Misfit is no excuse, which the bound itself may be the cause of.
    """
    if estimate.known is None:
        return []
    free = zip(estimate.parameters, estimate.known.mean, np.sqrt(np.diag(estimate.known.covariance)), strict=False)
    far = [
        (mean / std, mean, std, p.name) for p, mean, std in free if p.parameter.positive and mean < -MOST_MOVED * std
    ]
    if not far:
        return []
    away, mean, std, name = min(far)
    text = (
        f"{name} is held at its bound, 0: without it, it would be {mean:.3g} +- {std:.2g}, {-away:.0f} deviations away"
    )
    remedy = "check delays, gains and signs of the channels and the law, or let it be negative (scheme.positive)"
    return [Finding("bound", name, f"{text}; {remedy}")]


def _narrowed(estimate: Estimate) -> list[Finding]:
    """Deviations that shrank when the features were last made finer: the same record cannot have told more."""
    times = float(estimate.summary.get("narrowed_by_refinement", 1.0))
    if times < NARROWED:
        return []
    text = f"finer features made a parameter's deviation {times:.3g} times as small: how fine they are decides it"
    remedy = "compare with runs of fewer network.intervals; a higher sampling rate decides it"
    return [Finding("parameter", "parameters", f"{text}; {remedy}")]


def _rivals(estimate: Estimate) -> list[Finding]:
    """Other solutions that the record cannot tell from the one that is reported."""
    findings = []
    for rival in estimate.rivals:
        values = ", ".join(f"{name} = {x:.4g}" for name, x in rival.values.items())
        more, fewer = math.exp(max(rival.log_odds, 0.0)), math.exp(max(-rival.log_odds, 0.0))
        odds = f"{more:.3g} times as probable" if rival.log_odds > 0 else f"1/{fewer:.3g} as probable"
        text = f"another structure explains the record as well ({odds}): {values}; the nearest to the start is reported"
        remedy = "measure at another DOF, or prescribe a parameter of which you know something"
        findings.append(Finding("rival", "parameters", f"{text}; {remedy}"))
    return findings


def _moved(believed: Sequence[ParameterEstimate]) -> list[Finding]:
    """Together: one wrong parameter draws others along."""
    moves = sorted(
        ((abs(p.estimate - p.prescribed) / p.prior_std, p) for p in believed if p.prior_std > 0),
        key=lambda pair: -pair[0],
    )
    far = [(move, p) for move, p in moves if move > MOST_MOVED]
    if not far:
        return []
    moves_named = ", ".join(f"{p.name} by {move:.3g}" for move, p in far[:PARAMETERS_NAMED])
    more = f" and {len(far) - PARAMETERS_NAMED} more" if len(far) > PARAMETERS_NAMED else ""
    text = f"prescribed parameters moved by many of their prior standard deviations: {moves_named}{more}"
    return [Finding("moved", far[0][1].name, f"{text}; check them, or declare them unknown")]


def _spread(estimate: Estimate) -> list[Finding]:
    spread = estimate.summary.get("parameter_spread")
    if not isinstance(spread, int | float) or not spread > LARGE_SPREAD:
        return []
    text = f"the prescribed parameters are off by {spread:.3g} times what was believed (scheme.parameter_uncertainty)"
    return [Finding("spread", "parameters", f"{text}; check them, the masses and the units")]


def _spans(structure: Structure, estimate: Estimate, undetermined: Collection[str]) -> list[Finding]:
    """Connections that move further than their law goes, a guess there, or less, which leaves terms undetermined."""
    findings, untold = [], sought_laws(structure, [p for p in estimate.parameters if p.name in undetermined])
    for place, law in enumerate(structure.laws):
        for over, span in law.spans.items():
            motion = estimate.response.stretching[OVER.index(over)]
            history = structure.elongation(motion)[:, place]
            low, high = float(history.min()), float(history.max())
            too_wide = place in untold and span[1] - span[0] > SPARE * (high - low)
            if low < span[0] or high > span[1] or too_wide:
                name = structure.labels.connection(place)
                text = f"the {over} of connection {name} goes from {low:.3g} to {high:.3g}, its law from {span[0]:.3g}"
                text += f" to {span[1]:.3g}; give it {over}: [{SPARE * low:.3g}, {SPARE * high:.3g}]"
                findings.append(Finding("law", f"connection {name}", text, "sound"))
    return findings


def _frequencies(structure: Structure, record: Record, loose: Sequence[int]) -> list[Finding]:
    """Of the estimated structure; frequencies of zero are as they should be where DOFs are loose, from 0."""
    frequencies = modes_of(structure).natural_frequencies
    nyquist, least = 0.5 / record.step, 1.0 / record.duration
    above, below = (
        int(np.sum(frequencies > nyquist)),
        int(np.sum(frequencies[frequencies > 0 if loose else ...] < least)),
    )
    of_structure, suspect = "natural frequencies of the estimated structure are", "natural frequencies"
    findings = []
    # Modes beyond the record are there for what they bend under slow forces: those of a light part on stiff springs.
    if above == len(frequencies):
        text = f"{above} of {len(frequencies)} {of_structure} above the Nyquist frequency, {nyquist:.4g} Hz"
        text += f" (the highest: {frequencies[-1]:.4g} Hz); check the time axis and the units"
        findings.append(Finding("frequencies", suspect, text, "failed"))
    if below:
        text = f"{below} {of_structure} below one period per record, {least:.4g} Hz; check the time axis and the units"
        findings.append(Finding("frequencies", suspect, text, failed_if(below == len(frequencies))))
    if loose and not record.sensors("displacement")[[dof for dof in loose if dof < record.ndof]].any():
        text = f"the structure is not held: {record.dof_names(loose)} can move as a rigid body; without a displacement"
        findings.append(
            Finding("held", suspect, f"{text} sensor there, displacements are known up to a drift", "sound")
        )
    if np.isnan(frequencies).any():
        text = "the estimated structure is unstable: it has a negative stiffness"
        findings.append(Finding("frequencies", suspect, text, "failed"))
    return findings


def baseline_findings(estimate: Estimate, baseline: Estimate | None, record: Record) -> list[Finding]:
    """Parameters and displacements that the two do not agree on; nothing without a baseline."""
    if baseline is None:
        return []
    return _parameters_apart(estimate, baseline) + _displacements_apart(estimate, baseline, record)


def _parameters_apart(estimate: Estimate, baseline: Estimate) -> list[Finding]:
    of_baseline, findings = {p.name: p for p in baseline.parameters}, []
    for p in estimate.parameters:
        other = of_baseline.get(p.name)
        if other is None:
            continue
        difference, allowed = abs(p.estimate - other.estimate), APART * float(np.hypot(p.std, other.std))
        if difference > allowed and difference > LEAST_APART * max(abs(p.estimate), abs(other.estimate)):
            baseline_text = f"the baseline's {other.estimate:.4g} +- {other.std:.2g}"
            text = f"{p.name} is {p.estimate:.4g} +- {p.std:.2g}, and {baseline_text}"
            findings.append(Finding("baseline", p.name, f"{text}: one of them is wrong; look at the free run of each"))
    return findings


def _displacements_apart(estimate: Estimate, baseline: Estimate, record: Record) -> list[Finding]:
    displacement, of_baseline = estimate.response.displacement, baseline.response.displacement
    difference = np.sqrt(np.mean((displacement - of_baseline) ** 2, axis=0))
    allowed = APART * np.sqrt(np.mean(estimate.std.displacement**2 + baseline.std.displacement**2, axis=0))
    size = np.maximum(np.std(displacement, axis=0), np.std(of_baseline, axis=0))
    dofs = np.flatnonzero((difference > allowed) & (difference > LEAST_RESPONSE_APART * size))
    if not dofs.size:
        return []
    worst = int(dofs[np.argmax(difference[dofs] / size[dofs])])
    text = f"the displacement of {record.dof_names(dofs)} is not the baseline's"
    place = f"DOF {record.dof_name(worst)}"
    extent = f"{100 * difference[worst] / size[worst]:.0f} % of its rms apart on {place}"
    return [Finding("baseline", f"displacement of {place}", f"{text}: {extent}; look at the free run")]


def posterior_findings(posterior: PosteriorResult | None) -> list[Finding]:
    """A finding where the check failed, with its first sentence; all of them are printed with the draws."""
    if posterior is None or not posterior.verdict:
        return []
    first, *more = posterior.verdict
    text = f"the sampling failed its quality check, intervals may be wrong: {first}"
    return [Finding("sampling", "posterior", f"{text} (and {len(more)} more, see above)" if more else text)]
