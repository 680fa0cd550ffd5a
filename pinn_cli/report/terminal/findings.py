"""What a run says in sentences: of a model that does not hold, of changes, of peaks, of its score, and its verdict."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.report.terminal.columns import WIDTH, number

if TYPE_CHECKING:
    from pinn_cli.training.estimate import Changes, Peak, Story
    from pinn_cli.validation.base import Score
    from pinn_cli.verdict.finding import Verdict

SAID = {
    "force": "a force that the model leaves out acts on every coordinate",
    "free run": "the structure runs free, and what it misses is left in the sensors",
}
# Peaks that are told; all of them stand in the table.
PEAKS_OF, MOST_PEAKS, PARAMETERS_OF_A_STORY = ("drift", "connection_force"), 20, 8
SCORE_UNITS = {
    "heldout": "nats per withheld sample, 0 at best",
    "forecast": "log of error over noise, 0 at best",
    "evidence": "nats, up to a constant of the network",
}


def stories_text(stories: Sequence[Story]) -> str:
    """What is reported, how well each story predicts the record, and what the others say; "" of a model that holds."""
    if not stories:
        return ""
    reported, *others = stories
    lines = [f"The model does not quite hold. The parameters are those of a story in which {SAID[reported.name]}."]
    lines += [
        f"{story.name}: NMSE of a free run {story.free_run:.3g} %, of short ones {story.segments:.3g} %."
        for story in stories
    ]
    for story in others:
        unknown = [p for p in story.parameters if p.unknown][:PARAMETERS_OF_A_STORY]
        values = ", ".join(f"{p.name} {number(p.estimate)} +- {number(p.std, digits=2)}" for p in unknown)
        lines.append(f"If {SAID[story.name]}: {values} (stories.csv).")
    return "\n".join(textwrap.fill(line, WIDTH, break_on_hyphens=False) for line in lines)


def changes_text(changes: Changes | None) -> str:
    """What changed since earlier records; "" without any, and of a contradiction: the verdict tells it."""
    if changes is None or (not changes.found and changes.chance < changes.improbable):
        return ""
    if not changes.found:
        return f"no change since the earlier records (probability of such differences by chance: {changes.chance:.2g})"
    lines = []
    for change in changes.found:
        p = change.parameter
        if p.prescribed:
            by, std = 100.0 * change.by / p.prescribed, 100.0 * change.std / abs(p.prescribed)
            much = f"by {by:+.2g} +- {std:.1g} %"
        else:
            much = f"by {change.by:+.3g} +- {change.std:.1g} {p.unit}"
        chance = f"{change.chance:.1g}" if change.chance >= 1e-12 else "below 1e-12"
        share = f"{100.0 * change.share:.3g} % that it is this parameter"
        lines.append(f"changed: {p.name} ({p.owner}) {much}; by chance {chance}; {share}")
    return "\n".join(lines)


def peaks_text(peaks: Sequence[Peak]) -> str:
    """Peak drifts and forces of the connections; "" without a prediction."""
    if not peaks:
        return ""
    lines = [
        f"peak {peak.quantity.replace('_', ' ')} of connection {peak.of}: {number(peak.peak, digits=4)} {peak.unit}"
        f" at {peak.time:.4g} s, 90 %: {number(peak.lower_90, digits=4)} to {number(peak.upper_90, digits=4)}"
        for peak in [peak for peak in peaks if peak.quantity in PEAKS_OF][:MOST_PEAKS]
    ]
    return "\n".join([*lines, f"{len(peaks)} peaks with intervals: peaks.csv"])


def score_text(name: str, score: Score | None) -> str:
    """The line of the validation; empty without one."""
    if score is None:
        return ""
    value = f"{score.value:.5g}" if np.isfinite(score.value) else f"none: {score.reason}"
    return f"validation score ({name}; {SCORE_UNITS.get(name, 'lower is better')}): {value}"


def verdict_text(verdict: Verdict) -> str:
    """The verdict in one line, the last but one of a run; what is not sound has its reasons above it."""
    folded = textwrap.TextWrapper(WIDTH, initial_indent="- ", subsequent_indent="  ", break_on_hyphens=False)
    reasons = [folded.fill(finding.text) for finding in verdict.reasons]
    return "\n".join([*reasons, f"verdict: {verdict.word}"])
