"""Records of several that contradict the others: they cannot all be of the structure that was described."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pinn_cli.verdict.finding import Finding

if TYPE_CHECKING:
    from pinn_cli.training.estimate import Estimate

# Root mean square of a record's pull over its standard deviation, and the least difference worth a word, relative.
APART, LEAST_APART = 5.0, 0.02
NAMED = 3


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
