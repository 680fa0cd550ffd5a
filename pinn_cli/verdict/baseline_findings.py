"""Where an estimate and the baseline's differ by more than their standard deviations allow."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.verdict.finding import Finding

if TYPE_CHECKING:
    from pinn_cli.training.estimate import Estimate

# Standard deviations of the difference, and the least difference worth a word, relative.
DEVIATIONS, LEAST_PARAMETER, LEAST_RESPONSE = 5.0, 0.02, 0.1


def baseline_findings(estimate: Estimate, baseline: Estimate | None) -> list[Finding]:
    """Parameters and displacements that the two do not agree on; nothing without a baseline."""
    return [] if baseline is None else _parameters(estimate, baseline) + _displacements(estimate, baseline)


def _parameters(estimate: Estimate, baseline: Estimate) -> list[Finding]:
    others, found = {p.name: p for p in baseline.parameters}, []
    for p in estimate.parameters:
        other = others.get(p.name)
        if other is None:
            continue
        apart, allowed = abs(p.estimate - other.estimate), DEVIATIONS * float(np.hypot(p.std, other.std))
        if apart > allowed and apart > LEAST_PARAMETER * max(abs(p.estimate), abs(other.estimate)):
            theirs = f"the baseline's {other.estimate:.4g} +- {other.std:.2g}"
            text = f"{p.name} is {p.estimate:.4g} +- {p.std:.2g}, and {theirs}"
            found.append(Finding("baseline", p.name, f"{text}: one of them is wrong; look at the free run of each"))
    return found


def _displacements(estimate: Estimate, baseline: Estimate) -> list[Finding]:
    ours, theirs = estimate.response.displacement, baseline.response.displacement
    apart = np.sqrt(np.mean((ours - theirs) ** 2, axis=0))
    allowed = DEVIATIONS * np.sqrt(np.mean(estimate.std.displacement**2 + baseline.std.displacement**2, axis=0))
    size = np.maximum(np.std(ours, axis=0), np.std(theirs, axis=0))
    dofs = np.flatnonzero((apart > allowed) & (apart > LEAST_RESPONSE * size))
    if not dofs.size:
        return []
    worst = int(dofs[np.argmax(apart[dofs] / size[dofs])])
    named = ", ".join(str(dof + 1) for dof in dofs)
    text = f"the displacement of DOF{'s' if dofs.size > 1 else ''} {named} is not the baseline's"
    extent = f"{100 * apart[worst] / size[worst]:.0f} % of its rms apart on DOF {worst + 1}"
    return [Finding("baseline", f"displacement of DOF {worst + 1}", f"{text}: {extent}; look at the free run")]
