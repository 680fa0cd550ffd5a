"""What holds of every network: derivatives in time, continuity, precision, units of time."""

from __future__ import annotations

from itertools import pairwise

import pytest
import torch
from small_problems import accelerations, measured, small_chain, sped_up

from pinn_cli.network.base import Network
from pinn_cli.network.fourier import Fourier
from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.network.mlp import Mlp
from pinn_cli.network.spline import Spline
from pinn_cli.record.record import Record
from pinn_cli.settings.errors import InputError

DESIGNS = {
    "spline": Spline,
    "fourier": Fourier,
    "silu": lambda continuity: Mlp(3, 16, "silu", continuity),
    "tanh": lambda continuity: Mlp(3, 16, "tanh", continuity),
    "sine": lambda continuity: Mlp(3, 16, "sine", continuity),
    "embedded": lambda continuity: Mlp(2, 7, "sine", continuity, "fourier"),
}
every_kind = pytest.mark.parametrize("kind", DESIGNS)
both_continuities = pytest.mark.parametrize("continuity", ["exact", "penalised"])


@pytest.fixture(scope="module")
def record() -> Record:
    return accelerations(measured(small_chain(), snr_db=40.0).record)


def built(kind: str, record: Record, continuity: str = "exact", dtype: torch.dtype = torch.float64) -> Network:
    """A network with random weights."""
    network = DESIGNS[kind](continuity=continuity).build(record, dtype)
    if isinstance(network, LinearReadout):
        generator = torch.Generator().manual_seed(1)
        weights = torch.randn(network.readout.shape, generator=generator, dtype=torch.float64)
        network.readout.data = weights.to(dtype)
    return network


def between_the_samples(record: Record) -> torch.Tensor:
    """Times in no order, none of them a knot."""
    generator = torch.Generator().manual_seed(2)
    return torch.rand(50, generator=generator, dtype=torch.float64) * record.duration + record.time[0]


@both_continuities
@every_kind
def test_derivatives_are_those_of_autograd(record, kind, continuity):
    network = built(kind, record, continuity)
    time = between_the_samples(record).requires_grad_()
    jet = network.jet(time, 2)
    assert jet[0].shape == (50, 3 * network.channels)
    for lower, higher in pairwise(jet):
        expected = [torch.autograd.grad(column.sum(), time, retain_graph=True)[0] for column in lower.T]
        torch.testing.assert_close(higher, torch.stack(expected, -1), rtol=1e-6, atol=1e-8)
    for order in range(2):
        torch.testing.assert_close(network.jet(time, order), jet[: order + 1])


@both_continuities
@every_kind
def test_continuity_is_exact_or_a_residual(record, kind, continuity):
    network, time = built(kind, record, continuity), between_the_samples(record)
    states, (value, rate, curvature) = network(time), network.jet(time, 2)
    n = record.ndof
    if continuity == "exact":
        expected = (value, rate, curvature, None)
    else:
        expected = (value[:, :n], value[:, n:], rate[:, n:], rate[:, :n] - value[:, n:])
    torch.testing.assert_close(tuple(states), expected)


@every_kind
def test_float32_agrees_with_float64(record, kind):
    single, double = (built(kind, record, dtype=dtype) for dtype in (torch.float32, torch.float64))
    # Times that both can hold, so that only the features differ.
    time = between_the_samples(record).float().double()
    for low, high in zip(single.jet(time.float(), 2), double.jet(time, 2), strict=True):
        assert low.dtype == torch.float32
        torch.testing.assert_close(low.double(), high, rtol=1e-3, atol=1e-4 * high.abs().max().item())


@every_kind
def test_nothing_rests_on_the_unit_and_the_beginning_of_time(record, kind):
    fast = sped_up(record, 30.0)
    later = Record(**{**vars(record), "time": record.time + 1000.0})
    jets = [built(kind, given).jet(torch.tensor(given.time), 2) for given in (record, fast, later)]
    scale = jets[1][0].abs().max() / jets[0][0].abs().max()  # an MLP is in units of the record's amplitudes
    for order, (slow, quick) in enumerate(zip(*jets[:2], strict=True)):
        torch.testing.assert_close(quick, scale * slow * 30.0**order, rtol=1e-5, atol=1e-6 * quick.abs().max().item())
    torch.testing.assert_close(jets[2][0], jets[0][0], rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("design", [Fourier(), Fourier(harmonics=9), Mlp(2, 16)], ids=str)
def test_refining_leaves_what_is_no_spline_as_it_is(design):
    assert design.refined() is design


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: Spline(degree=2), "network.degree=2"),
        (lambda: Spline(knots_per_period=0.0), "network.knots_per_period=0.0"),
        (lambda: Spline(intervals=3), "network.intervals=3"),
        (lambda: Fourier(band_margin=0.0), "network.band_margin=0.0"),
        (lambda: Fourier(period_margin=0.5), "network.period_margin=0.5"),
        (lambda: Fourier(harmonics=0), "network.harmonics=0"),
        (lambda: Mlp(depth=0), "network.depth=0"),
        (lambda: Mlp(width=2.5), "network.width=2.5"),
        (lambda: Mlp(activation="relu"), "network.activation=relu: must be one of silu, tanh, sine"),
        (lambda: Mlp(continuity="none"), "network.continuity=none"),
        (lambda: Mlp(embedding="wavelet"), "network.embedding=wavelet: must be"),
    ],
)
def test_impossible_settings_are_named(make, named):
    with pytest.raises(InputError) as error:
        make()
    assert str(error.value).startswith(named)
