"""Laws of connections, and forces that a model may have left out."""

import numpy as np
import pytest
import torch

from pinn_cli.settings.errors import InputError
from pinn_cli.system.building import build_chain, build_partial_chain
from pinn_cli.system.connection import Duffing, Friction, Gap, Linear, Polynomial, PowerDamping, Spline, VanDerPol
from pinn_cli.system.connection.spline import NEAR_REST
from pinn_cli.system.left_out import LEFT_OUT, STRIBECK, sliding


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


def test_units():
    units = {"m": "kg", "c": "N s/m", "k": "N/m"}
    for kind, own in (
        (Linear(), {}),
        (Duffing(), {"kappa": "N/m^3"}),
        (VanDerPol(), {"mu": "N s/m"}),
        (PowerDamping(2), {"mu": "N (s/m)^2"}),
        (PowerDamping(1.5), {"mu": "N (s/m)^1.5"}),
        (Polynomial([7, 2]), {"k_2": "N/m^2", "k_7": "N/m^7"}),
        (Friction(0.1), {"F_c": "N"}),
        (Gap(), {"k_g": "N/m", "gap": "m"}),
        (Spline(speed=0.3, terms=2), {"h_1": "N", "h_2": "N"}),
    ):
        chain = build_chain(2, kind, m=1.0, c=1.0, k=1.0, **dict.fromkeys(own, 1.0))
        assert {p.kind: p.unit for p in chain.every_parameter()} == units | own


@pytest.mark.parametrize("sides", ["both", "positive", "negative"])
@pytest.mark.parametrize("gap", [0.0, 0.1])
def test_a_gap_pushes_where_it_is_closed_alone(sides, gap):
    e = np.linspace(-0.4, 0.4, 17)
    values = {"k_g": np.array(50.0), "gap": np.array(gap)}
    above = 50.0 * np.maximum(e - gap, 0.0) * (sides != "negative")
    below = 50.0 * np.maximum(-e - gap, 0.0) * (sides != "positive")
    np.testing.assert_allclose(Gap(sides).force(e, None, values), above - below, atol=1e-3 * 50.0 * max(gap, 1e-9))
    stretched = torch.tensor(e, requires_grad=True)
    force = Gap(sides).force(stretched, None, {name: torch.tensor(value) for name, value in values.items()})
    (slope,) = torch.autograd.grad(force.sum(), stretched)
    assert slope[e == 0.0].abs().item() < 51.0
    assert bool(slope.isfinite().all())


def test_a_gap_has_sides_that_there_are():
    with pytest.raises(InputError, match=r"system\.nonlinearity\.sides=left: must be one of both, positive, negative"):
        Gap("left")


@pytest.mark.parametrize("span", [0.02, (-0.01, 0.03)])
@pytest.mark.parametrize("over", ["elongation", "speed"])
def test_functions_of_a_curve_are_no_spring_and_none_at_rest(over, span):
    law, (low, high) = Spline(**{over: span}, terms=6), span if isinstance(span, tuple) else (-span, span)
    at, rest = np.linspace(low, high, 4001)[:, None], np.zeros((4001, 1))

    def force(at, kind):
        values = {each: np.array([float(each == kind)]) for each in law.parameters}
        return law.force(*((at, 0.0 * at) if over == "elongation" else (0.0 * at, at)), values)[:, 0]

    functions = np.stack([force(at, kind) for kind in law.parameters], -1)
    np.testing.assert_allclose(functions.T @ functions / len(at), np.eye(6), atol=5e-3)
    np.testing.assert_allclose(at[:, 0] @ functions / len(at), 0.0, atol=2e-3 * high)
    np.testing.assert_allclose(force(rest[:1], law.parameters[3]), 0.0, atol=1e-9)
    # The first is a parabola, and each of the others is rougher than the one before.
    distance = np.hypot(at[8:-4:4], NEAR_REST[over] * (high - low) / 2.0) ** 2.5
    roughness = np.mean((distance * np.diff(functions[::4], 3, axis=0)) ** 2, axis=0)
    assert np.all(np.diff(roughness) > 0.0)
    parabola = np.polynomial.Polynomial.fit(at[:, 0], functions[:, 0], 2)
    np.testing.assert_allclose(functions[:, 0], parabola(at[:, 0]), atol=1e-6)
    outside = force(high * np.array([[2.0], [3.0], [4.0]]), law.parameters[1])
    assert outside[2] - outside[1] == pytest.approx(outside[1] - outside[0])
    ones = dict.fromkeys(law.parameters, np.ones(1))
    slope = (law.stiffness_at_rest if over == "elongation" else law.damping_at_rest)(ones)
    step = np.array([[-1e-7], [1e-7]])
    difference = np.diff([sum(force(step[i : i + 1], kind)[0] for kind in law.parameters) for i in (0, 1)])
    np.testing.assert_allclose(slope, difference / 2e-7, rtol=1e-5)


@pytest.mark.parametrize("terms", [10, 30])
@pytest.mark.parametrize("over", ["elongation", "speed"])
def test_a_curve_says_what_it_is_too_coarse_for(over, terms):
    """Curves whose second derivative is white noise, which is what the prior says, and what comes nearest to them."""
    law, at, rng = Spline(**{over: 1.0}, terms=terms), np.linspace(-1.0, 1.0, 8001)[:, None], np.random.default_rng(5)
    moved = (at, 0.0 * at) if over == "elongation" else (0.0 * at, at)
    unit = np.eye(terms)[:, :, None]
    functions = np.concatenate([law.force(*moved, dict(zip(law.parameters, one, strict=True))) for one in unit], -1)
    missed, told = 0.0, 0.0
    for _ in range(20):
        bends = rng.standard_normal(len(at)) / np.hypot(at[:, 0], NEAR_REST[over]) ** 1.5
        curve = np.cumsum(np.cumsum(bends))
        curve -= curve[len(curve) // 2]
        made_of = np.linalg.lstsq(np.concatenate([at, functions], 1), curve, rcond=None)[0]
        values = dict(zip(law.parameters, made_of[1:, None], strict=True))
        missed += np.mean((curve - at[:, 0] * made_of[0] - functions @ made_of[1:]) ** 2)
        told += np.mean(law.unresolved(*moved, values) ** 2)
    assert 0.6 < np.sqrt(missed / told) < 1.3
    assert not np.any(Linear().unresolved(*moved, {}))


def nearest(law: Spline, curve: np.ndarray, at: np.ndarray) -> tuple[dict[str, np.ndarray], float]:
    """Terms of the curve that comes nearest, beside a spring, and how far it is off at most."""
    unit = np.eye(law.terms)[:, :, None]
    forces = [law.force(at, 0.0 * at, dict(zip(law.parameters, one, strict=True))) for one in unit]
    functions = np.concatenate([at, *forces], 1)
    made_of = np.linalg.lstsq(functions, curve, rcond=None)[0]
    return dict(zip(law.parameters, made_of[1:, None], strict=True)), float(np.max(abs(curve - functions @ made_of)))


@pytest.mark.parametrize("span", [0.02, (-0.01, 0.03)])
def test_knots_move_to_where_a_curve_bends(span):
    law, (low, high) = Spline(span), span if isinstance(span, tuple) else (-span, span)
    at = np.linspace(low, high, 8001)[:, None]
    kinked = np.maximum(at[:, 0] - 0.3 * high, 0.0) / high
    missed = [nearest(law, kinked, at)[1]]
    for _ in range(3):
        terms = nearest(law, kinked, at)[0]
        finer = law.bending_at(terms)
        knots = np.array(finer.knots["elongation"])
        assert len(knots) == law.terms
        np.testing.assert_allclose(knots[[0, -1]], (low, high))
        # Between functions a curve goes over as the one that comes nearest.
        carried = finer.terms_of(law, terms)
        apart = finer.force(at, 0.0 * at, carried) - law.force(at, 0.0 * at, terms)
        assert np.max(abs(apart)) < 3.0 * missed[-1]
        law = finer
        missed.append(nearest(law, kinked, at)[1])
    assert np.argmin(np.diff(knots)) in np.flatnonzero(abs(knots - 0.3 * high) < 0.1 * high)
    assert missed[-1] < 0.1 * missed[0]


def test_knots_stay_where_nothing_bends():
    law = Spline(0.02, 0.3)
    assert law.bending_at(dict.fromkeys(law.parameters, np.zeros(2))) is law
    (smooth,) = (x for x in law.curves if x[0] == "g_1")
    terms = dict.fromkeys(law.parameters, np.zeros(1)) | {smooth[0]: np.ones(1)}
    moved = law.bending_at(terms)
    assert moved.bending_at(moved.terms_of(law, terms)) is moved


@pytest.mark.parametrize("knots", [{"elongation": [-0.02, 0.0, 0.01]}, {"elongation": [0.02, 0.0, -0.02]}, {}, 3.0])
def test_given_knots_rise_from_one_end_of_the_span_to_the_other(knots):
    assert Spline(0.02, knots={"elongation": [-0.02, 0.0, 0.01, 0.02]}).terms == 4
    with pytest.raises(InputError, match=r"system\.nonlinearity\.knots\.elongation"):
        Spline(0.02, knots=knots)


@pytest.mark.parametrize("span", [-1.0, 0.0, [0.1, 0.2], [-0.1], "wide"])
def test_a_curve_goes_from_below_zero_to_above(span):
    with pytest.raises(InputError, match=r"system\.nonlinearity\.elongation"):
        Spline(span)
    with pytest.raises(InputError, match=r"system\.nonlinearity\.elongation=None: must be given"):
        Spline()


def test_curves_have_thirty_terms_in_all():
    assert len(Spline(0.1).parameters) == len(Spline(0.1, 0.2).parameters) == 30
    assert len(Spline(0.1, 0.2, terms=30).parameters) == 60


@pytest.mark.parametrize("orders", [[2], [3], [7], [2, 3], [2, 5, 7], [2, 3, 4, 5, 6, 7]])
def test_a_polynomial_spring_is_the_sum_of_its_powers(orders):
    e = np.linspace(-0.3, 0.4, 12).reshape(4, 3)
    values = {f"k_{order}": np.array([1.0, -2.0, 0.5]) * order for order in orders}
    expected = sum(values[f"k_{order}"] * e**order for order in orders)
    np.testing.assert_allclose(Polynomial(orders).force(e, e, values), expected, rtol=1e-13, atol=1e-16)
    tensors = {name: torch.tensor(value) for name, value in values.items()}
    np.testing.assert_allclose(
        Polynomial(orders).force(torch.tensor(e), None, tensors), expected, rtol=1e-13, atol=1e-16
    )


def test_a_chain_has_the_orders_that_are_given():
    unused = dict.fromkeys(("k_4", "k_5", "k_6", "k_7"))
    chain = build_chain(2, Polynomial(), m=1.0, c=1.0, k=1.0, k_2=0.0, k_3=[2.0, 3.0], **unused)
    assert list(chain.parameters) == ["m", "c", "k", "k_2", "k_3"]
    with pytest.raises(InputError, match=r"system\.k_2=nothing: must be given: a polynomial chain"):
        build_chain(2, Polynomial(), m=1.0, c=1.0, k=1.0)
    assert list(build_partial_chain(2, Polynomial(), m=1.0).parameters) == ["m", "c", "k", "k_2", "k_3"]
    with pytest.raises(InputError, match=r"system\.k_4=1\.0: must be left out"):
        build_chain(2, Polynomial([3]), m=1.0, c=1.0, k=1.0, k_3=1.0, k_4=1.0)
    with pytest.raises(InputError, match=r"system\.k_3=nothing"):
        build_chain(2, Polynomial([3]), m=1.0, c=1.0, k=1.0)


def test_friction_turns_round_within_its_speed_and_is_a_damper_at_rest():
    law, rates = Friction(0.02), np.array([-1.0, -0.02, 0.0, 1e-6, 0.1])
    force = law.force(rates, rates, {"F_c": np.full(5, 30.0)})
    np.testing.assert_allclose(force, 30.0 * np.tanh(rates / 0.02), rtol=1e-14)
    assert force[3] == pytest.approx(1e-6 * law.damping_at_rest({"F_c": np.array(30.0)}))
    assert law.stiffness_at_rest({"F_c": np.array(30.0)}) == 0.0


STEP = 0.01
TIME = STEP * np.arange(2000)


def test_a_mass_that_holds_moves_as_what_it_lies_on():
    moved = np.sin(3.0 * TIME)
    np.testing.assert_array_equal(sliding(moved, STEP, 1.1), moved)


def test_a_mass_that_slides_is_pulled_no_harder_than_it_holds_and_catches_up():
    """The same velocity in the end, once what it lies on has come to rest."""
    moved = np.where(TIME < 10.0, 3.0 * np.sin(4.0 * TIME), 0.0)
    pulled = sliding(moved, STEP, 1.0)
    assert np.abs(pulled).max() == pytest.approx(1.0)
    assert pulled.sum() * STEP == pytest.approx(moved.sum() * STEP, abs=1e-12)
    assert pulled[-1] == 0.0


def test_friction_that_differs_where_it_turns_round_is_nothing_in_motion():
    (force,) = (lacking.force for lacking in LEFT_OUT if lacking.kind == STRIBECK)
    e, de = np.sin(3.0 * TIME), 3.0 * np.cos(3.0 * TIME)
    found = force(e, de, 0.1 * np.sqrt(np.mean(e**2)))
    assert np.abs(found[np.abs(de) > 1.0]).max() < 1e-9
    slow = (np.abs(de) > 0.15) & (np.abs(de) < 0.2)
    assert np.all(found[slow] * np.sign(de[slow]) > 0.3)
