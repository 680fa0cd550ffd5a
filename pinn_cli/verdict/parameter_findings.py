"""What the estimated parameters say of an estimate: far from where they were believed, not determined, out of band.

And what the model lacks, where an estimate and the baseline's differ by more than their standard deviations allow, or
where draws of a posterior failed their quality check.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.system import left_out as lacking
from pinn_cli.system.connection.nonlinearity import OVER
from pinn_cli.system.coupling import loose_dofs
from pinn_cli.system.modes import modes_of
from pinn_cli.training.doubts.other_damping import DECISIVE_DAMPING
from pinn_cli.training.estimate import sought_laws
from pinn_cli.training.reported.stories import explain_most
from pinn_cli.verdict.finding import Finding, Word, failed_if

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    from pinn_cli.posterior.posterior import PosteriorResult
    from pinn_cli.record.record import Record
    from pinn_cli.scheme.problem import Problem
    from pinn_cli.system.structure import Structure
    from pinn_cli.training.estimate import Doubt, Estimate, ParameterEstimate

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
# Standard deviations by which something that is reported moves once a doubt is freed: below it intervals still hold.
MATTERS = 1.0
# By so much a damping ratio in the band must differ with another model of damping: what is less needs none.
RATIOS_APART = 0.1
# Share of what is left that is worth a word.
LEAST_SHARE = 0.05
# What a doubt found, of whom, with its size and its shape.
_LACKS, _OTHER = "the model of {of} lacks ", "{of} is another one, by {changed}"
FOUND = {
    lacking.CUBIC: _LACKS + "a cubic term of {number}",
    lacking.QUADRATIC: _LACKS + "a quadratic damping of {number}",
    lacking.FRICTION: _LACKS + "friction of {number}",
    lacking.STRIBECK: (
        _LACKS + "a friction that differs by {number} where it turns round (Stribeck: larger at rest than in motion)"
    ),
    lacking.ONE_SIDED: _LACKS + "a one-sided spring of {number} (it is stiffer one way)",
    lacking.ONE_SIDED_DAMPER: _LACKS + "a one-sided damper of {number} (it is stronger one way)",
    lacking.BACKLASH: _LACKS + "a backlash: {number} are missing beyond a gap of about +-{shape:.2g} m",
    lacking.HYSTERESIS: _LACKS + "a hysteresis: {number} that slip at about {shape:.2g} m",
    lacking.DRIFT: _LACKS + "a drift: its stiffness changes by {number} from the first to the last sample",
    lacking.MODE: "a mode at {shape:.3g} Hz is not in the model: as if {size:.2g} kg swung on {of}",
    lacking.DAMPED_MODE: f"the damping ratio of {_OTHER}",
    lacking.SLIDING: "{number} on {of} slide, beyond about {shape:.2g} m/s^2",
    "m": f"the mass of {_OTHER}",
    lacking.SPRING: f"the stiffness of {_OTHER}",
    lacking.DAMPER: f"the damping of {_OTHER}",
    "gain": "the {of} shows {gain:.4g} +- {std:.2g} times what the model does",
    "delay": "the {of} is {number} late",
    "tilt": "the {of} follows the displacement by {number}, as that of a sensor which tilts and feels gravity",
    lacking.ROCKING: "the base rocks: if storeys are of one height, it is {part} of what gives way to a turning moment",
    lacking.LINK: "{of} are joined by {number} that the model does not have",
    lacking.PLACE: "what the model leaves out acts on {of} alone, as a force of {value:.2g} N would",
    "high_pass": "the {of} lacks slow motion, as behind a high-pass filter of about {value:.2g} Hz",
}
# And what to do: mostly the overrides that add it.
_GIVE = "give {{of}} law: {law} with {parameters} unknown (system={law}, or in system.connections)"
_NO_FORM = "give {of} law: spline over its speed, of which no form is asked"
# Lets every mode have its own ratio.
OF_MODES = "try system.damping={{ratio: [null, ...]}}, a null for each mode in the band"
REMEDIES = {
    lacking.CUBIC: _GIVE.format(law="duffing", parameters="kappa"),
    lacking.QUADRATIC: _GIVE.format(law="power_damping", parameters="mu"),
    lacking.FRICTION: _GIVE.format(law="friction", parameters="F_c"),
    lacking.STRIBECK: _NO_FORM,
    lacking.ONE_SIDED: _GIVE.format(law="polynomial", parameters="k_2 and k_3"),
    lacking.ONE_SIDED_DAMPER: _NO_FORM,
    lacking.BACKLASH: _GIVE.format(law="gap", parameters="k, k_g and gap") + ", or take the play out of it",
    lacking.HYSTERESIS: _GIVE.format(law="jenkins", parameters="k_t and F_c") + ", or bouc_wen",
    lacking.DRIFT: "solve the record in parts (data.start, data.stop), or look at what changes: temperature, loosening",
    lacking.MODE: "add its mass and spring (system=structure), or keep to the band below (data.decimate)",
    lacking.DAMPED_MODE: OF_MODES,
    lacking.SLIDING: "fasten what lies there, or record a smaller motion",
    **dict.fromkeys(("m", lacking.SPRING, lacking.DAMPER), "check it"),
    "gain": "check its gain",
    # What acts from a sample to the next one, as a converter puts it out, acts half a sample later than it seems to.
    "delay": "check its clock (half a sample: data.intersample=zero_order_hold), or say delay: unknown (data.channels)",
    "tilt": "say tilt: unknown (data.channels)",
    lacking.ROCKING: "give the model its angle, a DOF that stretches every storey (weights)",
    lacking.LINK: "add that connection (system.connections)",
    lacking.PLACE: (
        "look for a support that moves, or a joint or load cell that is else than said; data.force={{{dof}: null}},"
        " beside the others, finds what acts there"
    ),
    "high_pass": "say high_pass: {value:.2g} (data.channels)",
}


def parameter_findings(problem: Problem, estimate: Estimate, structure: Structure) -> list[Finding]:
    """What is told of the parameters of an estimate; the structure has them."""
    kinds = {p.name: p.kind for p in problem.uncertain}
    unknown = [p for p in estimate.before_any_record if p.unknown]
    findings = [f for p in unknown for f in (*_far_from_believed(p), *_undetermined(p, kinds.get(p.name, "")))]
    undetermined = {finding.suspect for finding in findings if finding.kind == "not_identified"}
    return [
        *_spans(structure, estimate, undetermined),
        *findings,
        *_narrowed(estimate),
        *_beyond_bounds(estimate),
        *_rivals(estimate),
        *_moved([p for p in estimate.parameters if not p.unknown]),
        *_spread(estimate),
        *_frequencies(structure, problem.record, loose_dofs(problem.structure)),
    ]


def _far_from_believed(p: ParameterEstimate) -> Iterator[Finding]:
    """Of what may have either sign in prior standard deviations; of all else in decades from what the user says.

    Where nothing is said, the record or the program chose the start: that is nobody's belief.
    """
    said = p.parameter.said
    if said > 0 and p.estimate > 0 and not p.parameter.signed:
        decades = math.log10(p.estimate / said)
        if abs(decades) > GUESS_DECADES:
            where, word = "above" if decades > 0 else "below", failed_if(abs(decades) > UNIT_DECADES)
            text = f"{p.name} = {p.estimate:.4g} lies {abs(decades):.1f} decades {where} what you say of it, {said:.4g}"
            yield Finding("parameter", p.name, f"{text}; check units and masses", word)
    elif not p.parameter.positive and 0.0 < MOST_MOVED * p.prior_std < abs(p.estimate - p.prescribed):
        text = f"{p.name} = {p.estimate:.4g} is more than {MOST_MOVED:.0f} prior standard deviations from its start"
        yield Finding("parameter", p.name, f"{text}; start elsewhere (scheme.initial.{p.name})")


def _undetermined(p: ParameterEstimate, kind: str) -> Iterator[Finding]:
    """Beside its value; of what may as well be zero, beside its order of magnitude where that is larger."""
    if not np.isfinite(p.std):
        return
    value, size = abs(p.estimate), p.parameter.magnitude if p.parameter.may_vanish else 0.0
    allowed = IDENTIFIED if kind in ("m", "k") else ROUGHLY_IDENTIFIED
    if value <= 1e-9 * max(abs(p.prescribed), p.std) and size == 0.0:
        if p.held:
            text = f"the record does not determine {p.name}: it is held at its bound, and below {p.upper_90:.3g} (95 %)"
            yield Finding("not_identified", p.name, f"{text}; prescribe it, or measure nearer to it")
        else:
            text = f"{p.name} ended at zero; check the model, or start elsewhere (scheme.initial.{p.name})"
            yield Finding("parameter", p.name, text)
    elif not p.std <= max(allowed * value, IDENTIFIED * size):
        of = "its value" if value >= size else f"its order of magnitude, {size:.3g}"
        percent = f"{100 * p.std / max(value, size):.0f} %"
        text = f"the record does not determine {p.name}: its standard deviation is {percent} of {of}"
        yield Finding("not_identified", p.name, f"{text}; prescribe it, or measure nearer to it")


def _beyond_bounds(estimate: Estimate) -> Iterator[Finding]:
    """Bounds that the record contradicts: without them the parameter would be far beyond; the furthest is named.

    Misfit is no excuse, which the bound itself may be the cause of.
    """
    if estimate.known is None:
        return
    free = zip(estimate.parameters, estimate.known.mean, estimate.known.std, strict=False)
    far = [
        (mean / std, mean, std, p.name) for p, mean, std in free if p.parameter.positive and mean < -MOST_MOVED * std
    ]
    for away, mean, std, name in sorted(far)[:1]:
        beyond = f"without it, it would be {mean:.3g} +- {std:.2g}, {-away:.0f} deviations away"
        remedy = "check delays, gains and signs of the channels and the law, or let it be negative (scheme.positive)"
        yield Finding("bound", name, f"{name} is held at its bound, 0: {beyond}; {remedy}")


def _narrowed(estimate: Estimate) -> Iterator[Finding]:
    """Deviations that shrank when the features were last made finer: the same record cannot have told more."""
    times = float(estimate.summary.get("narrowed_by_refinement", 1.0))
    if times >= NARROWED:
        text = f"finer features made a parameter's deviation {times:.3g} times as small: how fine they are decides it"
        remedy = "compare with runs of fewer network.intervals; a higher sampling rate decides it"
        yield Finding("parameter", "parameters", f"{text}; {remedy}")


def _rivals(estimate: Estimate) -> Iterator[Finding]:
    """Other solutions that the record cannot tell from the one that is reported."""
    for rival in estimate.rivals:
        values = ", ".join(f"{name} = {x:.4g}" for name, x in rival.values.items())
        more, fewer = math.exp(max(rival.log_odds, 0.0)), math.exp(max(-rival.log_odds, 0.0))
        odds = f"{more:.3g} times as probable" if rival.log_odds > 0 else f"1/{fewer:.3g} as probable"
        text = f"another structure explains the record as well ({odds}): {values}; the nearest to the start is reported"
        remedy = "measure at another DOF, or prescribe a parameter of which you know something"
        yield Finding("rival", "parameters", f"{text}; {remedy}")


def _moved(believed: Sequence[ParameterEstimate]) -> Iterator[Finding]:
    """Together: one wrong parameter draws others along."""
    moves = [(abs(p.estimate - p.prescribed) / p.prior_std, p.name) for p in believed if p.prior_std > 0]
    if far := sorted((move for move in moves if move[0] > MOST_MOVED), key=lambda move: -move[0]):
        named = ", ".join(f"{name} by {move:.3g}" for move, name in far[:PARAMETERS_NAMED])
        more = f" and {len(far) - PARAMETERS_NAMED} more" if len(far) > PARAMETERS_NAMED else ""
        text = f"prescribed parameters moved by many of their prior standard deviations: {named}{more}"
        yield Finding("moved", far[0][1], f"{text}; check them, or declare them unknown")


def _spread(estimate: Estimate) -> Iterator[Finding]:
    spread = estimate.summary.get("parameter_spread")
    if isinstance(spread, int | float) and spread > LARGE_SPREAD:
        off = f"off by {spread:.3g} times what was believed (scheme.parameter_uncertainty)"
        text = f"the prescribed parameters are {off}; check them, the masses and the units"
        yield Finding("spread", "parameters", text)


def _spans(structure: Structure, estimate: Estimate, undetermined: Collection[str]) -> Iterator[Finding]:
    """Connections that move further than their law goes, a guess there, or less, which leaves terms undetermined."""
    untold = sought_laws(structure, [p for p in estimate.parameters if p.name in undetermined])
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
                yield Finding("law", f"connection {name}", text, "sound")


def _frequencies(structure: Structure, record: Record, loose: Sequence[int]) -> Iterator[Finding]:
    """Of the estimated structure; frequencies of zero are as they should be where DOFs are loose, from 0."""
    frequencies = modes_of(structure).natural_frequencies
    nyquist, least = 0.5 / record.step, 1.0 / record.duration
    held = frequencies[frequencies > 0] if loose else frequencies
    above, below = int(np.sum(frequencies > nyquist)), int(np.sum(held < least))
    of_structure, suspect = "natural frequencies of the estimated structure are", "natural frequencies"
    # Modes beyond the record are there for what they bend under slow forces: those of a light part on stiff springs.
    if above == len(frequencies):
        text = f"{above} of {len(frequencies)} {of_structure} above the Nyquist frequency, {nyquist:.4g} Hz"
        text += f" (the highest: {frequencies[-1]:.4g} Hz); check the time axis and the units"
        yield Finding("frequencies", suspect, text, "failed")
    if below:
        text = f"{below} {of_structure} below one period per record, {least:.4g} Hz; check the time axis and the units"
        yield Finding("frequencies", suspect, text, failed_if(below == len(frequencies)))
    if loose and not record.sensors("displacement")[[dof for dof in loose if dof < record.ndof]].any():
        text = f"the structure is not held: {record.dof_names(loose)} can move as a rigid body; without a displacement"
        yield Finding("held", suspect, f"{text} sensor there, displacements are known up to a drift", "sound")
    if np.isnan(frequencies).any():
        text = "the estimated structure is unstable: it has a negative stiffness"
        yield Finding("frequencies", suspect, text, "failed")


def baseline_findings(estimate: Estimate, baseline: Estimate | None, record: Record) -> list[Finding]:
    """Parameters and displacements that the two do not agree on; nothing without a baseline."""
    if baseline is None:
        return []
    of_baseline, findings = {p.name: p for p in baseline.parameters}, []
    for p, other in ((p, of_baseline[p.name]) for p in estimate.parameters if p.name in of_baseline):
        difference, allowed = abs(p.estimate - other.estimate), APART * float(np.hypot(p.std, other.std))
        if difference > allowed and difference > LEAST_APART * max(abs(p.estimate), abs(other.estimate)):
            theirs = f"the baseline's {other.estimate:.4g} +- {other.std:.2g}: one of them is wrong"
            text = f"{p.name} is {p.estimate:.4g} +- {p.std:.2g}, and {theirs}; look at the free run of each"
            findings.append(Finding("baseline", p.name, text))
    displacement, other_displacement = estimate.response.displacement, baseline.response.displacement
    difference = np.sqrt(np.mean((displacement - other_displacement) ** 2, axis=0))
    allowed = APART * np.sqrt(np.mean(estimate.std.displacement**2 + baseline.std.displacement**2, axis=0))
    size = np.maximum(np.std(displacement, axis=0), np.std(other_displacement, axis=0))
    dofs = np.flatnonzero((difference > allowed) & (difference > LEAST_RESPONSE_APART * size))
    if dofs.size:
        worst = int(dofs[np.argmax(difference[dofs] / size[dofs])])
        text = f"the displacement of {record.dof_names(dofs)} is not the baseline's"
        place = f"DOF {record.dof_name(worst)}"
        extent = f"{100 * difference[worst] / size[worst]:.0f} % of its rms apart on {place}"
        findings.append(Finding("baseline", f"displacement of {place}", f"{text}: {extent}; look at the free run"))
    return findings


def posterior_findings(posterior: PosteriorResult | None) -> list[Finding]:
    """A finding where the check failed, with its first sentence; all of them are printed with the draws."""
    if posterior is None or not posterior.verdict:
        return []
    first, *more = posterior.verdict
    text = f"the sampling failed its quality check, intervals may be wrong: {first}"
    return [Finding("sampling", "posterior", f"{text} (and {len(more)} more, see above)" if more else text)]


def doubt_findings(estimate: Estimate) -> list[Finding]:
    """One of each doubt that makes the record far more probable; those that move nothing are told of a sound run."""
    held, findings = {p.name.partition("_")[2]: p.name for p in estimate.parameters if p.held}, []
    for doubt in estimate.doubts:
        what, remedy = _said(doubt)
        # What a connection lacks may be what its own bound forbids, whatever term of another law resembles it most.
        parameter = held.get(doubt.of.removeprefix("connection "))
        if parameter is not None:
            remedy = f"{parameter} is held at its bound, 0: check the channels, or let it be negative (scheme.positive)"
        share = f", {100.0 * doubt.share:.0f} % of what it leaves out" if doubt.share > LEAST_SHARE else ""
        share += ", most of which has another cause" if share and not explain_most(estimate.doubts) else ""
        odds = f"the record is exp({doubt.log_odds:.0f}) times as probable with it"
        odds += " as with one on every DOF" if doubt.kind == lacking.PLACE else ""
        moved = f"{doubt.moved} moves by {doubt.moves:.1f} standard deviations"
        word: Word = "questionable" if doubt.moves > MATTERS else "sound"
        findings.append(Finding(doubt.kind, doubt.of, f"{what}{share}: {odds}, and {moved}; {remedy}", word))
    return findings + _other_damping(estimate)


def _other_damping(estimate: Estimate) -> list[Finding]:
    """Another model of damping with which the record is far more probable, and the ratios are others."""
    doubt = estimate.damping_doubt
    if doubt is None or not len(doubt.ratios) or doubt.log_odds < DECISIVE_DAMPING:
        return []
    ratios = np.stack((doubt.ratios, doubt.other_ratios))
    difference = np.abs(ratios[1] - ratios[0]) / np.abs(ratios).max(axis=0)
    worst = int(np.argmax(difference))
    if difference[worst] < RATIOS_APART:
        return []
    model, remedy = (
        ("a damping ratio for each mode", OF_MODES.format())
        if doubt.of_modes
        else ("dampers of the connections beside its ratios", "let c be unknown as well")
    )
    text = (
        f"with {model} the record is e^{doubt.log_odds:.0f} times as probable, and mode {worst + 1} has about"
        f" {100 * doubt.other_ratios[worst]:.2g} % damping instead of {100 * doubt.ratios[worst]:.2g} %"
    )
    return [Finding("damping", "parameters", f"{text}: the model of damping is wrong; {remedy}")]


def _said(doubt: Doubt) -> tuple[str, str]:
    """What was found, and what to do."""
    value, std, unit = doubt.value, doubt.std, doubt.unit
    fields = {
        "of": doubt.of, "dof": doubt.of.removeprefix("DOF "), "shape": doubt.shape, "value": value, "std": std,
        "size": abs(value), "gain": 1.0 + value, "part": f"{100.0 * value:.2g} +- {100.0 * std:.1g} %",
        "number": f"{value:.3g} +- {std:.2g} {unit}".rstrip(),
        "changed": f"{value:+.3g} +- {std:.2g} {unit}".rstrip(),
    }  # fmt: skip
    return FOUND[doubt.kind].format(**fields), REMEDIES[doubt.kind].format(**fields)
