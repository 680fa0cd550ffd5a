from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from pinn_cli.settings.errors import InputError
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing, Linear, PowerDamping, VanDerPol


@pytest.mark.parametrize("exponent", [1.0, 1.2, 1.5, 2.0, 2.5, 3.0])
def test_power_damping_has_a_finite_derivative_at_rest(exponent):
    damper = PowerDamping(exponent)
    mu = torch.tensor(0.75, dtype=torch.float64)
    rate = torch.tensor([-2.0, 0.0, 2.0], dtype=torch.float64, requires_grad=True)
    force = damper.force(torch.zeros_like(rate), rate, {"mu": mu})
    expected = 0.75 * rate.detach().sign() * rate.detach().abs() ** exponent
    torch.testing.assert_close(force.detach(), expected)
    (slope,) = torch.autograd.grad(force.sum(), rate)
    assert slope[1] == (0.75 if exponent == 1.0 else 0.0)
    torch.testing.assert_close(slope[2], torch.tensor(0.75 * exponent * 2.0 ** (exponent - 1.0), dtype=torch.float64))
    in_numpy = damper.force(np.zeros(3), rate.detach().numpy(), {"mu": np.array(0.75)})
    np.testing.assert_allclose(in_numpy, expected.numpy(), rtol=1e-14)


@pytest.mark.parametrize("exponent", [0.5, 0, -1.0, math.nan, math.inf, "2", True, None])
def test_power_damping_refuses_an_exponent_without_a_slope_at_rest(exponent):
    with pytest.raises(InputError, match=r"system\.nonlinearity\.exponent"):
        PowerDamping(exponent)


def test_linear_adds_nothing_in_any_dtype():
    e = torch.ones(2, 3, dtype=torch.float32)
    force = Linear().force(e, e, {})
    assert force.dtype == torch.float32
    assert not force.any()


def test_units():
    units = {"m": "kg", "c": "N s/m", "k": "N/m"}
    for kind, own in (
        (Linear(), {}),
        (Duffing(), {"kappa": "N/m^3"}),
        (VanDerPol(), {"mu": "N s/m"}),
        (PowerDamping(2), {"mu": "N (s/m)^2"}),
        (PowerDamping(1.5), {"mu": "N (s/m)^1.5"}),
    ):
        assert build_chain(2, kind, m=1.0, c=1.0, k=1.0, **dict.fromkeys(own, 1.0)).units == units | own
