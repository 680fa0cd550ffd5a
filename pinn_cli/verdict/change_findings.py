"""Records that contradict the earlier ones of a structure, beyond what a change of a few parameters explains."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pinn_cli.verdict.finding import Finding

if TYPE_CHECKING:
    from pinn_cli.training.estimate import Estimate


# Probabilities below it are all the same.
LEAST_TOLD = 1e-12


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
