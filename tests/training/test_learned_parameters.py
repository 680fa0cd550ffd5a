"""The chain's parameters as a module: units, bounds and what is reported of them."""

import math

import pytest
import torch
from small_problems import measured, small_chain

from pinn_cli.scheme.problem import Problem
from pinn_cli.system.parameters import Parameter
from pinn_cli.training.learned_parameters import LearnedParameters

UNCERTAIN = (
    Parameter("k", 1, 1.5, 255.0, scale=25.5, unknown=True, positive=True),
    Parameter("kappa", 0, 7.3, 1e3, scale=123.4, unknown=True, positive=True),
    Parameter("c", 2, 1.1, 0.1),
)


def learned(dtype: torch.dtype = torch.float32) -> LearnedParameters:
    structure = small_chain()
    values = {kind: value.clone() for kind, value in structure.parameters.items()}
    for p in UNCERTAIN:
        values[p.kind][p.index] = p.prescribed
    record = measured(structure, duration=3.0, samples=33).record
    return LearnedParameters(Problem(structure.with_parameters(**values), record, UNCERTAIN), dtype)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_step_is_counted_in_the_parameters_own_unit(dtype):
    parameters = learned(dtype)
    with torch.no_grad():
        parameters.moved += torch.tensor([0.1, 1.0, -0.2], dtype=dtype)
    values = {kind: value.detach() for kind, value in parameters().items()}
    rounding = 1e-6 if dtype == torch.float32 else 1e-15
    assert float(values["k"][1]) == pytest.approx(1.5 + 2.55, rel=rounding)
    assert float(values["kappa"][0]) == pytest.approx(7.3 + 123.4, rel=rounding)
    assert float(values["c"][2]) == pytest.approx(0.8 * 1.1, rel=rounding)
    assert float(values["k"][0]) == 15.0
    assert [p.estimate for p in parameters.estimates()] == pytest.approx([4.05, 130.7, 0.88], rel=rounding)
    assert float(parameters.prior().detach()) == pytest.approx(0.01**2 + 0.1234**2 + 2.2**2, rel=1e-6)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_below_its_bound_a_parameter_is_exactly_zero(dtype):
    parameters = learned(dtype)
    with torch.no_grad():
        parameters.moved -= 3.0
    parameters.respect_bounds()
    assert [p.estimate for p in parameters.estimates()][:2] == [0.0, 0.0]
    assert parameters.estimates()[2].estimate == pytest.approx(1.1 - 3.3)
    assert float(parameters()["k"][1].detach()) == pytest.approx(0.0, abs=1e-6)


def test_estimates_say_what_was_believed_and_nothing_of_their_spread():
    for given, p in zip(learned().estimates(), UNCERTAIN, strict=True):
        assert (given.name, given.prescribed, given.estimate) == (p.name, p.prescribed, p.prescribed)
        assert (given.prior_std, given.unknown) == (p.prior_std, p.unknown)
        assert all(math.isnan(x) for x in (given.std, given.lower_90, given.upper_90))
