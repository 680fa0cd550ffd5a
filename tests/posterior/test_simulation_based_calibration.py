"""Simulation-based calibration (Talts et al. 2018): true parameters drawn from their priors rank anywhere among draws.

Of every problem the chain's parameters come from the priors that the scheme is told, and its record from that chain.
If posteriors are what they claim to be, the share of draws below the truth is uniform over many problems.
"""

import numpy as np
import pytest
from bayesian_problems import posed
from scipy.stats import chisquare
from small_problems import NONLINEARITIES

from pinn_cli.network.spline import Spline
from pinn_cli.posterior.laplace import Laplace
from pinn_cli.scheme.bayesian import Bayesian, checked_priors
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.system.building import build_chain
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import RunContext
from pinn_cli.training.gauss_newton import GaussNewton

PROBLEMS, DRAWS, BINS = 100, 999, 10
# Of one parameter: seven of them, so that one calibrated program in 1400 fails.
ALARM = 1e-4
# No truth may be further from its posterior's mean, in standard deviations: ranks do not see how far outside it is.
FARTHEST = 6.0
PRIORS = {
    "c": {"kind": "log_normal", "median": 1.0, "sigma": 0.4},
    "k": {"kind": "gamma", "mean": 15.0, "std": 3.0},
    "kappa": {"kind": "gamma", "mean": 100.0, "std": 40.0},
}
# Fixed: in records as short as these the band that a network is made for is now and then mistaken.
DESIGN = Spline(intervals=90)


def random_structure(nonlinearity: str, ndof: int, generator: np.random.Generator) -> Structure:
    kinds = ("c", "k", *NONLINEARITIES[nonlinearity][1])
    priors = checked_priors({kind: PRIORS[kind] for kind in kinds})
    values = {kind: prior.sample(generator, ndof).tolist() for kind, prior in priors.items()}
    return build_chain(ndof, NONLINEARITIES[nonlinearity][0], m=10.0, **values)


def rank_and_distance(chain: Structure, seed: int) -> dict[str, tuple[float, float]]:
    """Of every parameter the share of draws below the truth, and how far the truth is from their mean."""
    scheme = Bayesian(priors={kind: PRIORS[kind] for kind in chain.parameters if kind != "m"})
    problem, run = posed(chain, scheme, seed=seed, rms=6.0), RunContext(seed=seed)
    likelihoods = GaussNewton().solve(JointProblem.of(problem), DESIGN, run).likelihoods
    samples = Laplace(DRAWS).sample(likelihoods.marginal, problem.priors, run)
    out = {}
    for parameter, draws in zip(problem.uncertain, samples.draws[0].T, strict=True):
        truth = float(chain.parameters[parameter.kind][parameter.index])
        out[parameter.name] = (float(np.mean(draws < truth)), float(abs(truth - draws.mean()) / draws.std()))
    return out


@pytest.mark.slow
@pytest.mark.parametrize(("nonlinearity", "ndof"), [("linear", 2), ("duffing", 1)])
def test_ranks_of_the_truth_are_uniform(nonlinearity, ndof):
    rows = []
    for seed in range(PROBLEMS):
        chain = random_structure(nonlinearity, ndof, np.random.default_rng([seed, 77]))
        rows.append(rank_and_distance(chain, seed))
    for name in rows[0]:
        ranks, distances = np.array([row[name] for row in rows]).T
        counts, _ = np.histogram(ranks, BINS, (0.0, 1.0))
        probability = chisquare(counts).pvalue
        print(f"{name}: ranks {counts.tolist()}, p = {probability:.4f}, farthest {distances.max():.1f} deviations")
        assert probability > ALARM, (
            f"{name}: ranks of the truth among the draws {counts.tolist()}, p = {probability:.2g}"
        )
        assert distances.max() < FARTHEST, f"{name}: a truth {distances.max():.1f} standard deviations from the mean"
