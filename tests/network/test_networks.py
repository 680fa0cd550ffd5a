"""What holds of every network: derivatives in time, continuity, precision, units of time; and of linear readouts."""

from itertools import pairwise

import pytest
import torch
from small_problems import accelerations, measured, small_chain, sped_up

from pinn_cli.network.fourier import Fourier
from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.network.mlp import Mlp
from pinn_cli.network.network import Network
from pinn_cli.network.spline import Spline, SplineNetwork
from pinn_cli.record.channels import record_band
from pinn_cli.record.record import Record

DESIGNS = {
    "spline": Spline,
    "fourier": Fourier,
    "silu": lambda continuity: Mlp(3, 16, "silu", continuity),
    "tanh": lambda continuity: Mlp(3, 16, "tanh", continuity),
    "sine": lambda continuity: Mlp(3, 16, "sine", continuity),
    "embedded": lambda continuity: Mlp(2, 7, "sine", continuity, "fourier"),
}
every_linear_kind = pytest.mark.parametrize("kind", ["spline", "fourier"])
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


@both_continuities
@every_linear_kind
def test_segments_agree_with_the_network(record, kind, continuity):
    network = built(kind, record, continuity)
    time = torch.tensor(record.time)
    segments, states = network.segments(time), network(time)
    # Feature g of output c is number channels * g + c.
    weights = network.readout.movedim(0, 1).flatten(0, 1)[segments.feature]
    assert segments.count == network.channels * network.count
    for features, (name, expected) in zip(
        (*segments.orders, segments.continuity), states._asdict().items(), strict=True
    ):
        assert (features is None) == (expected is None), name
        if features is not None:
            torch.testing.assert_close(segments.scatter(features @ weights), expected)
            torch.testing.assert_close(segments.scatter(segments.gather(expected)), expected)


@pytest.mark.parametrize("degree", [3, 4, 5, 7])
def test_splines_sum_to_one_everywhere(record, degree):
    network = Spline(degree).build(record)
    network.readout.data.fill_(1.0)
    ends = torch.tensor([network.start, network.start + network.intervals * network.spacing])
    value, rate, curvature = network.jet(torch.cat((torch.tensor(record.time), ends.double())), 2)
    torch.testing.assert_close(value, torch.ones_like(value))
    for derivative in (rate, curvature):
        torch.testing.assert_close(derivative, torch.zeros_like(derivative), rtol=0.0, atol=1e-9)


def test_a_quintic_spline_reproduces_a_quintic_polynomial():
    network = SplineNetwork(1, -1.0, 2.0, 9, 5, "exact", torch.float64)
    time = torch.linspace(-1.0, 2.0, 200, dtype=torch.float64)
    coefficients = (0.3, -1.0, 2.0, 0.7, -0.4, 0.2)
    polynomial = sum(c * time**p for p, c in enumerate(coefficients))
    first = sum(p * c * time ** max(p - 1, 0) for p, c in enumerate(coefficients))
    second = sum(p * (p - 1) * c * time ** max(p - 2, 0) for p, c in enumerate(coefficients))
    segments = network.segments(time)
    features = torch.zeros(len(time), network.count, dtype=torch.float64)
    scattered = segments.scatter(segments.orders[0])
    features.scatter_(1, segments.scatter(segments.feature[:, None].expand(*segments.sample.shape, -1)), scattered)
    network.readout.data = torch.linalg.lstsq(features, polynomial[:, None]).solution[None]
    for given, expected in zip(network.jet(time, 2), (polynomial, first, second), strict=True):
        torch.testing.assert_close(given[:, 0], expected, rtol=1e-9, atol=1e-9)


def test_a_spline_is_smooth_across_its_knots(record):
    network = built("spline", record)
    knots = network.start + network.spacing * torch.arange(1, network.intervals, dtype=torch.float64)
    gap = 1e-9 * network.spacing
    for before, after in zip(network.jet(knots - gap, 2), network.jet(knots + gap, 2), strict=True):
        torch.testing.assert_close(before, after, rtol=1e-5, atol=1e-6 * after.abs().max().item())


@every_linear_kind
def test_the_size_depends_on_the_record_and_not_on_its_time_scale(record, kind):
    fast = DESIGNS[kind]().build(sped_up(record, 30.0))
    slow = DESIGNS[kind]().build(record)
    assert fast.count == slow.count
    assert fast.free_intervals == pytest.approx(30.0 * slow.free_intervals)


def test_a_refined_spline_has_a_quarter_more_knots(record):
    design = Spline(degree=4, continuity="penalised")
    fine, coarse = design.refined().build(record), design.build(record)
    # A knot interval is a whole number of collocation points wide, of which there are three at least: two thirds to
    # four thirds of what was asked for where there are as few.
    widths = [network.spacing / record.step for network in (fine, coarse)]
    for network, wanted in ((fine, 5.0), (coarse, 4.0)):
        assert 1.0 / network.spacing >= wanted * record_band(record)
        assert 1.0 / network.spacing <= 4.0 / 3.0 * wanted * record_band(record)
    assert widths[0] < widths[1]
    assert (fine.degree, fine.continuity) == (4, "penalised")
    assert design.knots_per_period is None  # the design itself stays as it was
    assert vars(design.refined().refined()) == vars(design.refined())


@pytest.mark.parametrize("settings", [{"knots_per_period": 3.0}, {"intervals": 20}], ids=str)
def test_a_spline_whose_knots_the_user_chose_keeps_them(record, settings):
    design = Spline(**settings)
    assert design.refined().build(record).intervals == design.build(record).intervals
