"""What bounds leave of what a record says: the numbers of the table, and the most probable ones."""

import numpy as np
import pytest

from pinn_cli.model.knowledge import ParameterKnowledge
from pinn_cli.model.truncated_gaussian import TruncatedGaussian
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.bounded_estimates import bounded_estimates

LOWER = np.array([0.0, -np.inf, 0.0])


def knowledge(mean: list[float], told: float = 0.0) -> ParameterKnowledge:
    """Three parameters in units of their own, the first two strongly correlated."""
    unit = np.array([1.0, 1e3, 1e-4])
    covariance = np.array([[1.0, -0.9, 0.2], [-0.9, 1.0, 0.1], [0.2, 0.1, 1.0]])
    weight = np.full(3, told**2) / unit**2
    return ParameterKnowledge(np.array(mean) * unit, covariance * np.outer(unit, unit), told / unit, weight, 1e2 * unit)


@pytest.mark.parametrize("told", [0.0, 0.5])
@pytest.mark.parametrize("first", [-6.0, -1.0, 0.5, 30.0])
def test_what_a_model_is_used_with_is_what_the_table_says(first, told):
    known = knowledge([first, 20.0, 50.0], told)
    uncertain = [
        Parameter(name, 0, 0.0, 1.0, positive=bool(low == 0.0)) for name, low in zip("ckm", LOWER, strict=True)
    ]
    posterior = TruncatedGaussian(known.mean, known.covariance, LOWER)
    mode = np.maximum(known.mean, LOWER)
    table = bounded_estimates(uncertain, np.ones(3), mode, posterior, known.hidden)
    mean, covariance = known.within(LOWER)
    np.testing.assert_allclose(mean, [p.estimate for p in table], rtol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), [p.std for p in table], rtol=1e-9)
    assert np.linalg.eigvalsh(covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))).min() > 0.0


def test_the_most_probable_values_above_a_bound_move_along_with_the_one_that_it_holds():
    known = knowledge([-6.0, 20.0, 50.0])
    found = known.most_probable(LOWER)
    np.testing.assert_allclose(found, [0.0, (20.0 - 0.9 * 6.0) * 1e3, (50.0 + 0.2 * 6.0) * 1e-4], atol=1e-6)
    inside = knowledge([6.0, 20.0, 50.0])
    np.testing.assert_array_equal(inside.most_probable(LOWER), inside.mean)
