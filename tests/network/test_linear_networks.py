"""Networks with a linear readout: splines and Fourier features."""

from __future__ import annotations

import pytest
import torch
from small_problems import accelerations, measured, small_chain, sped_up

from pinn_cli.network.fourier import Fourier
from pinn_cli.network.spline import Spline, SplineNetwork
from pinn_cli.record.channels import record_band
from pinn_cli.record.record import Record

DESIGNS = {"spline": Spline, "fourier": Fourier}


@pytest.fixture(scope="module")
def record() -> Record:
    return accelerations(measured(small_chain(), snr_db=40.0).record)


def filled(network):
    """The network with random readout weights."""
    generator = torch.Generator().manual_seed(1)
    weights = torch.randn(network.readout.shape, generator=generator, dtype=torch.float64)
    network.readout.data = weights.to(network.readout.dtype)
    return network


@pytest.mark.parametrize("continuity", ["exact", "penalised"])
@pytest.mark.parametrize("kind", DESIGNS)
def test_segments_agree_with_the_network(record, kind, continuity):
    network = filled(DESIGNS[kind](continuity=continuity).build(record))
    time = torch.tensor(record.time)
    segments, states = network.segments(time), network(time)
    # Feature g of output c is number channels * g + c.
    weights = network.readout.movedim(0, 1).flatten(0, 1)[segments.feature]
    assert segments.count == network.channels * network.count
    for name, expected in states._asdict().items():
        features = getattr(segments, name)
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
    scattered = segments.scatter(segments.displacement)
    features.scatter_(1, segments.scatter(segments.feature[:, None].expand(*segments.sample.shape, -1)), scattered)
    network.readout.data = torch.linalg.lstsq(features, polynomial[:, None]).solution[None]
    for given, expected in zip(network.jet(time, 2), (polynomial, first, second), strict=True):
        torch.testing.assert_close(given[:, 0], expected, rtol=1e-9, atol=1e-9)


def test_a_spline_is_smooth_across_its_knots(record):
    network = filled(Spline().build(record))
    knots = network.start + network.spacing * torch.arange(1, network.intervals, dtype=torch.float64)
    gap = 1e-9 * network.spacing
    for before, after in zip(network.jet(knots - gap, 2), network.jet(knots + gap, 2), strict=True):
        torch.testing.assert_close(before, after, rtol=1e-5, atol=1e-6 * after.abs().max().item())


@pytest.mark.parametrize("kind", DESIGNS)
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
