"""The verdict on several records that were solved together."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from pinn_cli.verdict.finding import Finding, Verdict

if TYPE_CHECKING:
    from collections.abc import Sequence


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
