"""What a story allows for of others."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from small_estimates import parameter_estimate

from pinn_cli.training.reported.stories import story_distance


def test_what_the_other_story_says_counts_beyond_what_both_allow_for():
    free = SimpleNamespace(
        trained=SimpleNamespace(
            solution=SimpleNamespace(point=SimpleNamespace(parameters=torch.tensor([1.5, 0.2, 7.0])))
        ),
        covariance=np.diag([0.01, 0.03, 1.0]),
        varying=np.array([0.0, 0.1, 0.0]),
    )
    found = SimpleNamespace(evidence=SimpleNamespace(equations=SimpleNamespace(scale=np.array([2.0, 2.0, 1.0]))))
    # Of three unknowns the last is a first state, which is no parameter.
    forced = SimpleNamespace(parameters=[parameter_estimate(f"k_{i}", 10.0, 10.0, 0.2, 9.7, 10.3) for i in (1, 2)])
    expected = [(1.5**2 - 0.01 - 0.1**2) ** 0.5, 0.0, 0.0]
    assert story_distance(found, free, [forced]) == pytest.approx(expected, rel=1e-6)
    further = SimpleNamespace(parameters=[parameter_estimate(f"k_{i}", 10.0, 12.0, 0.2, 11.7, 12.3) for i in (1, 2)])
    expected = [expected[0], (0.8**2 - 0.1**2 - 0.03 - 0.1**2) ** 0.5, 0.0]
    assert story_distance(found, free, [forced, further]) == pytest.approx(expected, rel=1e-6)
