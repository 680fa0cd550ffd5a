"""Every estimator on structures that are no chains: braces, weighted connections, several laws, any order."""

from itertools import product

import numpy as np
import pytest
from small_problems import measured
from solved_records import by_spline
from structures import braced, shuffled

from pinn_cli.baseline.kalman_smoother import KalmanSmoother
from pinn_cli.network.mlp import Mlp
from pinn_cli.report.fitness import fitness_percent
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.training.estimate import RunContext
from pinn_cli.training.gauss_newton import GaussNewton

ESTIMATORS = {
    "spline": by_spline,
    "mlp": lambda problem: GaussNewton().solve(problem, Mlp(1, None, "sine", embedding="fourier"), RunContext()),
    "smoother": lambda problem: KalmanSmoother().solve(problem, RunContext()),
}


STRUCTURES = {"braced": braced(), "shuffled": shuffled(4)}
LONG = {("braced", "mlp"): pytest.mark.slow}


@pytest.mark.parametrize(
    ("name", "estimator"), [pytest.param(*x, marks=LONG.get(x, ())) for x in product(STRUCTURES, ESTIMATORS)]
)
def test_the_motion_of_a_mass_without_a_sensor(name, estimator):
    structure = STRUCTURES[name]
    measurements = measured(structure, "exact", snr_db=40.0, duration=12.0, samples=601)
    scheme = SparseRecovery(unobserved=[structure.ndof])
    problem = scheme.pose(structure, [scheme.observe(measurements.record)])
    found, truth = ESTIMATORS[estimator](problem).response, measurements.truth.response
    for quantity in ("displacement", "velocity", "acceleration"):
        scores = fitness_percent(getattr(found, quantity), getattr(truth, quantity))
        assert np.all(scores > 98.0), (quantity, scores)
