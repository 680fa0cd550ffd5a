"""Draws of a posterior that failed their quality check: what they say of the parameters may be wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pinn_cli.verdict.finding import Finding

if TYPE_CHECKING:
    from pinn_cli.posterior.result import PosteriorResult


def posterior_findings(posterior: PosteriorResult | None) -> list[Finding]:
    """A finding where the check failed, with its first sentence; all of them are printed with the draws."""
    if posterior is None or not posterior.verdict:
        return []
    first, *more = posterior.verdict
    text = f"the sampling failed its quality check, intervals may be wrong: {first}"
    return [Finding("sampling", "posterior", f"{text} (and {len(more)} more, see above)" if more else text)]
