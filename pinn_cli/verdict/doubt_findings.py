"""What the model lacks: terms of connections, masses, and what sensors show beside what they are said to feel."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pinn_cli.system.left_out import TERMS
from pinn_cli.verdict.finding import Finding

if TYPE_CHECKING:
    from pinn_cli.training.estimate import Doubt, Estimate

# Standard deviations by which something that is reported moves once a doubt is freed: below it intervals still hold.
MATTERS = 1.0


def doubt_findings(estimate: Estimate) -> list[Finding]:
    """One of each doubt that makes the record far more probable; those that move nothing are told of a sound run."""
    return [_finding(doubt) for doubt in estimate.doubts]


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
