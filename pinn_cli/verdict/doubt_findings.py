"""What the model lacks: terms of connections, masses, and what sensors show beside what they are said to feel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.system.left_out import (
    BACKLASH,
    CUBIC,
    DAMPED_MODE,
    DAMPER,
    DRIFT,
    FRICTION,
    HYSTERESIS,
    LEFT_OUT,
    MODE,
    ONE_SIDED,
    PLACE,
    QUADRATIC,
    ROCKING,
    SLIDING,
    SPRING,
    STRIBECK,
)
from pinn_cli.training.doubts.other_damping import DECISIVE_DAMPING
from pinn_cli.verdict.finding import Finding

if TYPE_CHECKING:
    from pinn_cli.training.estimate import Doubt, Estimate

# Standard deviations by which something that is reported moves once a doubt is freed: below it intervals still hold.
MATTERS = 1.0
# By so much a damping ratio in the band must differ with another model of damping: what is less needs none.
RATIOS_APART = 0.1
# Share of what is left that is worth a word.
LEAST_SHARE = 0.05
# What lets every mode have its own.
OF_MODES = "try system.damping={ratio: [null, ...]}, a null for each mode in the band"
# Numbers that are held.
HELD = {"m": "mass", SPRING: "stiffness", DAMPER: "damping"}
# What a connection lacks, with its size and its shape.
LACKS = {
    CUBIC: "a cubic term of {number}",
    QUADRATIC: "a quadratic damping of {number}",
    FRICTION: "friction of {number}",
    STRIBECK: "a friction that differs by {number} where it turns round (Stribeck: larger at rest than in motion)",
    ONE_SIDED: "a one-sided spring of {number} (it is stiffer one way)",
    BACKLASH: "a backlash: {number} are missing beyond a gap of about +-{shape:.2g} m",
    HYSTERESIS: "a hysteresis: {number} that slip at about {shape:.2g} m",
    DRIFT: "a drift: its stiffness changes by {number} from the first to the last sample",
}
# What acts from a sample to the next one, as a converter puts it out, acts half a sample later than it seems to.
OF_DELAY = "check its clock (half a sample: data.intersample=zero_order_hold), or say delay: unknown (data.channels)"
# Where the record contradicts the bound of its parameter, a law that has it lacks it all the same.
OWN = {lacking.kind: lacking.parameter for lacking in LEFT_OUT if lacking.parameter}
# The overrides that add it.
_GIVE = "give {{of}} law: {law} with {parameters} unknown (system={law}, or in system.connections)"
LAWS = {
    CUBIC: _GIVE.format(law="duffing", parameters="kappa"),
    QUADRATIC: _GIVE.format(law="power_damping", parameters="mu"),
    FRICTION: _GIVE.format(law="friction", parameters="F_c"),
    STRIBECK: "give {of} law: spline over its speed, of which no form is asked",
    ONE_SIDED: _GIVE.format(law="polynomial", parameters="k_2 and k_3"),
    BACKLASH: _GIVE.format(law="gap", parameters="k, k_g and gap") + ", or take the play out of it",
    HYSTERESIS: _GIVE.format(law="jenkins", parameters="k_t and F_c") + ", or bouc_wen",
    DRIFT: "solve the record in parts (data.start, data.stop), or look at what changes: temperature, loosening",
}


def doubt_findings(estimate: Estimate) -> list[Finding]:
    """One of each doubt that makes the record far more probable; those that move nothing are told of a sound run."""
    held = {p.name for p in estimate.parameters if p.held}
    return [_finding(doubt, held) for doubt in estimate.doubts] + _other_damping(estimate)


def _other_damping(estimate: Estimate) -> list[Finding]:
    """Another model of damping with which the record is far more probable, and the ratios are others."""
    doubt = estimate.damping_doubt
    if doubt is None or not len(doubt.ratios) or doubt.log_odds < DECISIVE_DAMPING:
        return []
    difference = np.abs(doubt.other_ratios - doubt.ratios) / np.maximum(
        np.abs(doubt.ratios), np.abs(doubt.other_ratios)
    )
    worst = int(np.argmax(difference))
    if difference[worst] < RATIOS_APART:
        return []
    model, remedy = (
        ("a damping ratio for each mode", OF_MODES)
        if doubt.of_modes
        else ("dampers of the connections beside its ratios", "let c be unknown as well")
    )
    text = (
        f"with {model} the record is e^{doubt.log_odds:.0f} times as probable, and mode {worst + 1} has about"
        f" {100 * doubt.other_ratios[worst]:.2g} % damping instead of {100 * doubt.ratios[worst]:.2g} %"
    )
    return [Finding("damping", "parameters", f"{text}: the model of damping is wrong; {remedy}")]


def _finding(doubt: Doubt, held: set[str]) -> Finding:
    what, remedy = _said(doubt)
    parameter = f"{OWN.get(doubt.kind)}_{doubt.of.removeprefix('connection ')}"
    if parameter in held:
        remedy = f"{parameter} is held at its bound, 0: check the channels, or let it be negative (scheme.positive)"
    share = f", {100.0 * doubt.share:.0f} % of what it leaves out" if doubt.share > LEAST_SHARE else ""
    odds = f"the record is exp({doubt.log_odds:.0f}) times as probable with it"
    odds += " as with one on every DOF" if doubt.kind == PLACE else ""
    moved = f"{doubt.moved} moves by {doubt.moves:.1f} standard deviations"
    text = f"{what}{share}: {odds}, and {moved}; {remedy}"
    return Finding(doubt.kind, doubt.of, text, "questionable" if doubt.moves > MATTERS else "sound")


def _said(doubt: Doubt) -> tuple[str, str]:
    """What was found, and what to do."""
    number = f"{doubt.value:.3g} +- {doubt.std:.2g} {doubt.unit}".rstrip()
    percent = f"{100.0 * doubt.value:.2g} +- {100.0 * doubt.std:.1g} %"
    unmeasured = f"data.force={{{doubt.of.removeprefix('DOF ')}: null}}, beside the others, finds what acts there"
    changed = f"{doubt.value:+.3g} +- {doubt.std:.2g} {doubt.unit}".rstrip()
    if doubt.kind in LAWS:
        return f"the model of {doubt.of} lacks {LACKS[doubt.kind].format(number=number, shape=doubt.shape)}", (
            LAWS[doubt.kind].format(of=doubt.of)
        )
    said = {
        MODE: (
            f"a mode at {doubt.shape:.3g} Hz is not in the model: as if {abs(doubt.value):.2g} kg swung on {doubt.of}",
            "add its mass and spring (system=structure), or keep to the band below (data.decimate)",
        ),
        DAMPED_MODE: (f"the damping ratio of {doubt.of} is another one, by {changed}", OF_MODES),
        SLIDING: (
            f"{number} on {doubt.of} slide, beyond about {doubt.shape:.2g} m/s^2",
            "fasten what lies there, or record a smaller motion",
        ),
        **{kind: (f"the {word} of {doubt.of} is another one, by {changed}", "check it") for kind, word in HELD.items()},
        "gain": (
            f"the {doubt.of} shows {1.0 + doubt.value:.4g} +- {doubt.std:.2g} times what the model does",
            "check its gain",
        ),
        "delay": (f"the {doubt.of} is {number} late", OF_DELAY),
        "tilt": (
            f"the {doubt.of} follows the displacement by {number}, as that of a sensor which tilts and feels gravity",
            "say tilt: unknown (data.channels)",
        ),
        ROCKING: (
            f"the base rocks: if storeys are of one height, it is {percent} of what gives way to a turning moment",
            "give the model its angle, a DOF that stretches every storey (weights)",
        ),
        PLACE: (
            f"what the model leaves out acts on {doubt.of} alone, as a force of {doubt.value:.2g} N would",
            f"look for a support that moves, or a joint or load cell that is else than said; {unmeasured}",
        ),
        "high_pass": (
            f"the {doubt.of} lacks slow motion, as behind a high-pass filter of about {doubt.value:.2g} Hz",
            f"say high_pass: {doubt.value:.2g} (data.channels)",
        ),
    }
    return said[doubt.kind]
