"""Cases of all other families, in turn, with one fault of the record or of the model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib.util import find_spec
from itertools import count

import numpy as np

from benchmarks.trust.case import Case
from benchmarks.trust.families import FAMILIES, drawn
from benchmarks.trust.faults import FAULTS, RESPONSES, channels, spoil


def draw(seed: int) -> Case:
    """The fault is drawn; the next of the list stands in for one that the case cannot have."""
    rng = np.random.default_rng([seed, 111])
    others = [name for name in FAMILIES if name != "spoilt" and find_spec(f"benchmarks.trust.families.{name}")]
    whole = _judged(others[seed % len(others)], 1000 + seed // len(others))
    spoilt = spoil(whole, rng, list(FAULTS)[int(rng.integers(len(FAULTS)))])
    return replace(spoilt, family="spoilt", seed=seed, about=f"{spoilt.fault} in {whole.name}: {whole.about}")


def _judged(family: str, seed: int) -> Case:
    """The first case from a seed on with a sensor to spoil: a prediction has none, and no verdict."""
    for further in count(seed):
        case = drawn(family, further)
        if isinstance(case.settings["data"], Mapping) and any(c.quantity in RESPONSES for c in channels(case)):
            return case
    raise AssertionError
