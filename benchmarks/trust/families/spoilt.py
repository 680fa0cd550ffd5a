"""Cases of other families, in turn, with one fault of the record or of the model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import count

import numpy as np

from benchmarks.trust.case import Case
from benchmarks.trust.families import drawn
from benchmarks.trust.faults import FAULTS, RESPONSES, channels, spoil

# Whose cases are spoilt, in turn. One more makes other cases of every seed: rows of earlier programs are lost.
SPOILT = (
    "chain",
    "topology",
    "ground",
    "damping",
    "nonlinear",
    "unmeasured",
    "finite_elements",
    "sensors",
    "records",
    "posterior",
)


def draw(seed: int) -> Case:
    """The fault is drawn; the next of the list stands in for one that the case cannot have."""
    rng = np.random.default_rng([seed, 111])
    whole = _judged(SPOILT[seed % len(SPOILT)], 1000 + seed // len(SPOILT))
    spoilt = spoil(whole, rng, list(FAULTS)[int(rng.integers(len(FAULTS)))])
    return replace(spoilt, family="spoilt", seed=seed, about=f"{spoilt.fault} in {whole.name}: {whole.about}")


def _judged(family: str, seed: int) -> Case:
    """The first case from a seed on with a sensor to spoil: a prediction has none, and no verdict."""
    for further in count(seed):
        case = drawn(family, further)
        if isinstance(case.settings["data"], Mapping) and any(c.quantity in RESPONSES for c in channels(case)):
            return case
    raise AssertionError
