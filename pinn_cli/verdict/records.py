"""Records that contradict each other: several that were solved together, or one and those before it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from pinn_cli.verdict.finding import Finding, Verdict
from pinn_cli.verdict.parameter_findings import APART, LEAST_APART

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pinn_cli.training.estimate import Estimate

NAMED = 3
# Probabilities below it are all the same.
LEAST_TOLD = 1e-12


def contradictions(estimate: Estimate) -> list[Finding]:
    """A finding for the record that is farthest from the others, if it pulls at the parameters beyond chance."""
    together = {p.name: p.estimate for p in estimate.parameters}
    found = []
    for number, one in enumerate(estimate.disagreements, start=1):
        off = {name: value / together[name] - 1.0 for name, value in one.alone.items() if together.get(name)}
        far = sorted((name for name in off if abs(off[name]) > LEAST_APART), key=lambda name: -abs(off[name]))
        if one.square > APART**2 * one.freedom and far:
            found.append((abs(off[far[0]]), number, far[:NAMED]))
    if not found:
        return []
    _, number, names = max(found)
    alone = estimate.disagreements[number - 1].alone
    named = ", ".join(f"{name} = {alone[name]:.4g} (all together: {together[name]:.4g})" for name in names)
    others = "the other one" if len(estimate.disagreements) == 2 else "the others"
    remedy = "check its units, gains and DOFs, whether the structure had changed, and the model; or leave it out"
    text = f"record {number} contradicts {others}: by itself it says {named}; {remedy}"
    return [Finding("contradiction", f"record {number}", text)]


def verdict_of_records(each: Sequence[Verdict | None], among: Sequence[Finding] = ()) -> Verdict | None:
    """The worst of all; what every record says in the same words, as of the parameters, is told once.

    Args:
        each: Of every record; None where there is none.
        among: What they say of each other, and what is said of all.
    """
    verdicts = [verdict for verdict in each if verdict is not None]
    if len(verdicts) < 2:
        return Verdict.of([*verdicts[0].reasons, *among]) if verdicts else None
    texts = [{finding.text for finding in verdict.reasons} for verdict in verdicts]
    common = set.intersection(*texts)
    findings = [*among]
    findings += [finding for finding in verdicts[0].reasons if finding.text in common]
    for number, verdict in enumerate(verdicts, start=1):
        findings += [_of_record(finding, number) for finding in verdict.reasons if finding.text not in common]
    return Verdict.of(findings)


def _of_record(finding: Finding, number: int) -> Finding:
    return replace(finding, suspect=f"record {number}: {finding.suspect}", text=f"record {number}: {finding.text}")


def change_findings(estimate: Estimate) -> list[Finding]:
    """Where what changed, nothing perhaps, leaves more of a contradiction than chance does; where much changed at once.

    A sensor whose gain is another one now looks like several parameters that changed: a twentieth of one gain was seen
    to be three stiffnesses and a damping.
    """
    changes = estimate.changes
    if changes is None:
        return []
    found, names = [], ", ".join(change.parameter.name for change in changes.found)
    if changes.chance < changes.improbable:
        remedy = "check units, gains and DOFs of its channels; if the structure is another one now, identify it anew"
        beyond = f"beyond what changes of {names} explain" if names else "and no one parameter explains it"
        chance = f"by chance {changes.chance:.1g}" if changes.chance >= LEAST_TOLD else f"by chance below {LEAST_TOLD}"
        text = f"the record contradicts the earlier ones {beyond} ({chance}); {remedy}"
        found.append(Finding("contradiction", "record", text))
    if len(changes.found) > 1:
        remedy = "check the channels, or learn their gains along (data.channels)"
        text = f"{names} changed at once; a sensor whose gain changed looks like that as well: {remedy}"
        found.append(Finding("changes", names, text))
    return found
