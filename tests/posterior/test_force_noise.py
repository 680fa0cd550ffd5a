"""The noise of a load cell beside accelerometers alone, which leave it open: its draws, and the truth."""

import numpy as np
import pytest
import storeys
from solved_records import by_spline, model

from pinn_cli.posterior.marginal import Marginal
from pinn_cli.posterior.result import diagnose
from pinn_cli.scheme.bayesian import Bayesian
from pinn_cli.training.estimate import RunContext


@pytest.mark.slow
def test_short_chains_draw_it_as_well_as_the_parameters():
    """R-hat was 1.1 and 13 to 90 of 1000 draws were effective: the likelihood's peak lay beyond its table."""
    made = storeys.record(1)
    problem = Bayesian(unknown=["k_*", "c_*"]).pose(model(made), [made.record])
    found = by_spline(problem).likelihoods
    scales = np.linspace(-5.0, 5.0, 101) * found.marginal.s_std
    values = [found.marginal.evaluate(found.marginal.peak, s)[0] for s in scales]
    assert abs(scales[np.argmax(values)]) < found.marginal.s_std
    samples = Marginal(4, 150, 200).sample(found.marginal, problem.priors, RunContext())
    noise = diagnose(samples).set_index("parameter").loc["sigma_force_3"]
    assert noise["r_hat"] < 1.02
    assert min(noise["ess_bulk"], noise["ess_tail"]) > 400.0
    assert abs(noise["mean"] - made.noise["force"][2]) < 3.0 * noise["std"]
    assert noise["std"] < 0.2 * noise["mean"]
