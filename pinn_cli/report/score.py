"""The validation score as a run reports it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pinn_cli.validation.base import Score

UNITS = {
    "heldout": "nats per withheld sample, 0 at best",
    "forecast": "log of error over noise, 0 at best",
    "evidence": "nats, up to a constant of the network",
}


def score_record(name: str, score: Score | None) -> dict[str, Any]:
    """The entry of run.json; none without a validation."""
    if score is None:
        return {}
    found = {"score": score.value if np.isfinite(score.value) else None}
    return {"validation": {"name": name, **found, **({"reason": score.reason} if score.reason else {})}}


def score_text(name: str, score: Score | None) -> str:
    """The line of the terminal; empty without a validation."""
    if score is None:
        return ""
    value = f"{score.value:.5g}" if np.isfinite(score.value) else f"none: {score.reason}"
    return f"validation score ({name}; {UNITS.get(name, 'lower is better')}): {value}"
