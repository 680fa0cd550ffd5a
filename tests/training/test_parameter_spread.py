"""How far believed parameters are off in common: intervals under the spread that is learned, on Gaussians alone."""

import numpy as np
import pytest

from pinn_cli.training.parameter_spread import updated_spread

INSIDE_90 = 1.645


def posterior(told: np.ndarray, noise: float) -> tuple[np.ndarray, float]:
    """Means (p,) and standard deviation, in the user's, of parameters that a record tells to within ``noise``."""
    spread = 1.0
    for _ in range(200):
        variance = 1.0 / (spread**-2 + noise**-2)
        mean = variance * told / noise**2
        before, spread = spread, updated_spread(mean, np.full(len(told), variance), spread)
        if abs(spread / before - 1.0) < 1e-4:
            break
    return mean, float(np.sqrt(variance))


@pytest.mark.parametrize("noise", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("count", [1, 3, 12])
def test_intervals_hold_where_the_user_is_as_uncertain_as_he_says(count, noise):
    """Of one to twelve dampers that a record tells half they held 70 to 80 %: chance passed for a sharp user."""
    rng, held = np.random.default_rng(0), []
    for _ in range(1200 // count):
        truth = rng.standard_normal(count)
        mean, std = posterior(truth + noise * rng.standard_normal(count), noise)
        held.extend(np.abs(mean - truth) < INSIDE_90 * std)
    assert 0.82 < np.mean(held) < 0.96


def test_many_that_are_right_sharpen_each_other_and_wrong_ones_free_each_other():
    assert posterior(np.zeros(18), 0.5)[1] < 0.3
    mean, _ = posterior(np.array([8.0, -6.0, 7.0]), 0.5)
    assert mean == pytest.approx([8.0, -6.0, 7.0], rel=0.03)
