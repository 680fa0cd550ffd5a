"""What the model lacks: terms of connections, masses, and what sensors show beside what they are said to feel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.system.left_out import TERMS
from pinn_cli.verdict.finding import Finding

if TYPE_CHECKING:
    from pinn_cli.training.estimate import Doubt, Estimate

# Standard deviations by which something that is reported moves once a doubt is freed: below it intervals still hold.
MATTERS = 1.0
# Another model of damping counts from these odds on, as a logarithm: one of many doubts has to be more probable, this
# one is asked alone. And a damping ratio in the band must differ by so much: what is less needs no other model.
OTHER_DAMPING, RATIOS_APART = 6.0, 0.1


def doubt_findings(estimate: Estimate) -> list[Finding]:
    """One of each doubt that makes the record far more probable; those that move nothing are told of a sound run.

    Beside another model of damping that makes it more probable still the others are not told: they stand in for it.
    """
    damping = _other_damping(estimate)
    least = estimate.damping_doubt.log_odds if damping and estimate.damping_doubt is not None else 0.0
    return damping + [_finding(doubt) for doubt in estimate.doubts if doubt.log_odds > least]


def _other_damping(estimate: Estimate) -> list[Finding]:
    """Another model of damping with which the record is far more probable, and the ratios are others."""
    doubt = estimate.damping_doubt
    if doubt is None or not len(doubt.ratios) or doubt.log_odds < OTHER_DAMPING:
        return []
    apart = np.abs(doubt.others - doubt.ratios) / np.maximum(np.abs(doubt.ratios), np.abs(doubt.others))
    worst = int(np.argmax(apart))
    if apart[worst] < RATIOS_APART:
        return []
    model, remedy = (
        ("a damping ratio for each mode", "try system.damping={ratio: [null, ...]}, a null for each mode in the band")
        if doubt.of_modes
        else ("dampers of the connections beside its ratios", "let c be unknown as well")
    )
    text = (
        f"with {model} the record is e^{doubt.log_odds:.0f} times as probable, and mode {worst + 1} has about"
        f" {100 * doubt.others[worst]:.2g} % damping instead of {100 * doubt.ratios[worst]:.2g} %"
    )
    return [Finding("damping", "parameters", f"{text}: the model of damping is wrong; {remedy}")]


def _finding(doubt: Doubt) -> Finding:
    what, remedy = _said(doubt)
    moved = f"{doubt.moved} moves by {doubt.moves:.1f} standard deviations with it"
    text = f"{what}: the record is exp({doubt.log_odds:.0f}) times as probable with it, and {moved}; {remedy}"
    return Finding(doubt.kind, doubt.of, text, "questionable" if doubt.moves > MATTERS else "sound")


def _said(doubt: Doubt) -> tuple[str, str]:
    """What was found, and what to do."""
    number = f"{doubt.value:.3g} +- {doubt.std:.2g} {doubt.unit}".rstrip()
    if doubt.kind in {title for _, title in TERMS.values()}:
        return f"the model of {doubt.of} lacks a {doubt.kind} of {number}".replace("a friction", "friction"), (
            "give the connection a law with it (docs/how-to/my-structure.md)"
        )
    said = {
        "m": (f"the mass of {doubt.of} is another one, by {doubt.value:+.3g} +- {doubt.std:.2g} kg", "check it"),
        "gain": (
            f"the {doubt.of} shows {1.0 + doubt.value:.4g} +- {doubt.std:.2g} times what the model does",
            "check its gain",
        ),
        "delay": (f"the {doubt.of} is {number} late", "check its clock, or say delay: unknown (data.channels)"),
        "tilt": (
            f"the {doubt.of} follows the displacement by {number}, as that of a sensor which tilts and feels gravity",
            "say tilt: unknown (data.channels)",
        ),
        "high_pass": (
            f"the {doubt.of} lacks slow motion, as behind a high-pass filter of about {doubt.value:.2g} Hz",
            f"say high_pass: {doubt.value:.2g} (data.channels)",
        ),
    }
    return said[doubt.kind]
