"""How much a setting matters, for scores that are made of known settings."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from pinn_cli.sweep.search_trials import importance

GENERATOR = np.random.default_rng(0)
NUMBER = pd.Series(GENERATOR.uniform(1.0, 100.0, 60))
CHOICE = pd.Series(GENERATOR.choice(["a", "b", "c"], 60))


def test_what_the_score_is_made_of_explains_it() -> None:
    assert importance(NUMBER, NUMBER**3) == pytest.approx(1.0)
    assert importance(NUMBER, (NUMBER - 50.0) ** 2) > 0.9  # least in the middle
    assert importance(CHOICE, CHOICE.map({"a": 3.0, "b": 1.0, "c": 2.0})) == pytest.approx(1.0)


def test_what_it_is_not_made_of_explains_little() -> None:
    assert importance(NUMBER, pd.Series(GENERATOR.normal(size=60))) < 0.15
    assert importance(CHOICE, NUMBER) < 0.15


def test_too_little_to_tell() -> None:
    assert np.isnan(importance(NUMBER[:3], NUMBER[:3]))
    assert np.isnan(importance(pd.Series(["a"] * 9), NUMBER[:9]))
