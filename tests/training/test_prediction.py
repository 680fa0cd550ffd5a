"""Free runs of an identified structure and their bands."""

from dataclasses import replace

import numpy as np
import pytest
from independent_records import IndependentRecord, measured, random_force
from independent_records import Structure as Circuit
from one_record import by_spline
from storeys import C, K, M, record, response

from pinn_cli.model.knowledge import Levels, Misfit, Model, ParameterKnowledge
from pinn_cli.network.spline import Spline
from pinn_cli.record.record import Record
from pinn_cli.scheme.predict import Predict
from pinn_cli.scheme.state_parameter import StateParameter
from pinn_cli.settings.errors import InputError
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing, Linear
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import Estimate, RunContext, estimated_structure
from pinn_cli.training.gauss_newton import GaussNewton
from pinn_cli.training.prediction import Predictor

STRUCTURE = build_chain(3, Linear(), m=M.tolist(), c=C.tolist(), k=K.tolist())


def model(std: float = 0.0, discrepancy: float = 0.0, structure=STRUCTURE) -> Model:
    """Springs known to a part of their value."""
    own = tuple(replace(p, positive=True) for p in structure.every_parameter() if p.kind == "k") if std else ()
    mean = np.array([p.prescribed for p in own])
    known = ParameterKnowledge(mean, np.diag((std * mean) ** 2), 0.0 * mean, 0.0 * mean, mean)
    levels = Levels({"force": np.array([np.nan, np.nan, 30.0])}, discrepancy, 0.02, 2000.0, 50.0)
    return Model(structure, own, known, levels, None, "sound", "")


def force_alone(seed: int = 5, duration: float = 12.0) -> Record:
    moved = response(seed, duration=duration)
    blank = np.full_like(moved.force, np.nan)
    return Record(moved.time, blank, blank, blank, moved.force, np.array([True, True, False]), responds=False)


def predicted(given: Model, seen: Record, **settings) -> Estimate:
    scheme = Predict(given, **settings)
    problem = scheme.pose(STRUCTURE, [seen])
    return Predictor(GaussNewton(), Spline(), given, scheme).solve(problem, RunContext())


def test_it_is_the_motion_of_the_structure():
    true, found = response(5), predicted(model(), force_alone(), draws=20, measured_input=False)
    for quantity in ("displacement", "velocity", "acceleration"):
        exact = getattr(true, quantity)
        assert np.abs(getattr(found.response, quantity) - exact).max() < 1e-3 * np.abs(exact).max()
        assert getattr(found.std, quantity).max() < 1e-12 * np.abs(exact).max()


def test_a_given_start():
    start = np.array([0.01, 0.02, 0.03, 0.1, -0.2, 0.3])
    given = {"displacement": start[:3].tolist(), "velocity": start[3:].tolist()}
    exact = response(5, start=start).displacement
    found = predicted(model(), force_alone(), start=given, draws=20).response.displacement
    assert np.abs(found - exact).max() < 1e-3 * np.abs(exact).max()


def test_bands_and_peaks_are_those_of_other_structures_that_are_possible():
    found = predicted(model(0.01), force_alone(), draws=100)
    rng, count = np.random.default_rng(0), 40
    others = [response(5, K * (1.0 + 0.01 * rng.standard_normal(3))) for _ in range(count)]
    spread = np.sqrt(np.mean([(o.displacement - response(5).displacement) ** 2 for o in others], axis=0))
    rms = np.sqrt(np.mean(found.std.displacement**2, axis=0))
    np.testing.assert_allclose(rms, np.sqrt(np.mean(spread**2, axis=0)), rtol=0.35)
    peaks = {(p.quantity, p.of): p for p in found.peaks}
    assert len(peaks) == 15
    for i in range(3):
        drift = [np.abs(np.diff(o.displacement, axis=1, prepend=0.0)[:, i]).max() for o in others]
        peak = peaks["drift", str(i + 1)]
        inside = np.mean([peak.lower_90 <= x <= peak.upper_90 for x in drift])
        assert 0.7 <= inside <= 1.0
        assert peak.unit == "m"


def with_noise(seen: Record, sigma: float, seed: int = 1) -> Record:
    noise = np.where(seen.unforced, 0.0, sigma * np.random.default_rng(seed).standard_normal(seen.force.shape))
    return replace(seen, force=seen.force + noise)


def spread(given: Model, seen: Record, **settings) -> float:
    return float(np.sqrt(np.mean(predicted(given, seen, draws=40, **settings).std.displacement ** 2)))


@pytest.mark.slow
def test_discrepancy_and_noise_of_a_measured_force_widen_the_bands():
    known, exact, noisy = model(0.001), force_alone(), with_noise(force_alone(), 30.0)
    quiet = spread(known, noisy, measured_input=False)
    assert quiet < 0.8 * spread(known, noisy)
    assert spread(known, noisy) < spread(model(0.001, discrepancy=200.0), noisy)
    # A computed force shows that it has none.
    assert spread(known, exact) == pytest.approx(spread(known, exact, measured_input=False), rel=1e-3)


@pytest.mark.parametrize("most", [9.0, pytest.param(22.0, marks=pytest.mark.slow)])
def test_bands_of_a_measured_force_hold_what_its_noise_does(most):
    """By default: whether the spectrum shows the noise, or content up to 22 of 25 Hz hides it and the run tells it."""
    inside = []
    for seed in range(4):
        exact = response(seed, most=most)
        found = predicted(model(), with_noise(replace(force_alone(), force=exact.force), 30.0, seed), draws=20)
        off = np.abs(found.response.displacement - exact.displacement)
        inside.append(np.mean(off < 1.645 * found.std.displacement))
    assert 0.7 < np.mean(inside) < 0.99, inside


def with_misfit(history: np.ndarray, acting: float, rest: float = 0.0, step: float = 0.02) -> Model:
    return replace(model(), misfit=Misfit.of(step, history, acting, rest))


def test_the_force_that_was_left_out_acts_again_as_large_a_part_of_the_input():
    seen = force_alone(duration=4.0)
    acting, moved = float(np.sqrt(np.mean(seen.force**2))), response(9).acceleration
    history = 100.0 * moved / np.sqrt(np.mean(moved**2))  # as of wrong masses

    def left_out(acting: float, part: float = 1.0, rest: float = 0.0) -> float:
        return spread(with_misfit(part * history, acting, rest), seen, measured_input=False)

    usual = left_out(acting)
    assert left_out(2.0 * acting) == pytest.approx(0.5 * usual, rel=1e-6)
    assert usual > 1.5 * spread(model(discrepancy=100.0), seen)  # it has most of its power where the structure answers
    assert left_out(acting, 0.0, 100.0) == pytest.approx(left_out(0.0, 0.0, 100.0), rel=1e-6)


def test_the_parameters_hide_no_more_of_it_than_there_is_at_their_frequencies():
    known = replace(model(0.01).known, told=np.full(3, 1e2), weight=np.full(3, 1e-2))  # 1e4 N/m may be hidden of each
    misfit = Misfit.of(0.02, np.zeros((4, 3)), 1.0, 0.0, at_motion=0.3)
    given = replace(model(0.01), known=known, misfit=misfit)
    found = [p.prior_std for p in Predict(given).pose(STRUCTURE, [force_alone(duration=4.0)]).alone.uncertain]
    hidden = 0.3 / np.hypot(1.0 / 1e4, 0.3 / known.first_std)
    np.testing.assert_allclose(found, np.hypot(0.01 * known.mean, hidden), rtol=1e-6)


def circuit(quadratic: float, seed: int) -> tuple[Structure, IndependentRecord]:
    """A mass of 1 on a cubic spring at 68 Hz and on a quadratic one, which the model lacks; a record of 2 s."""
    k, time = (2.0 * np.pi * 68.0) ** 2, np.arange(1220) / 610.0
    true = Circuit(np.ones(1), np.array([38.0]), np.array([k]), np.array([3.8 * k]), quadratic * k)
    moved = true.moved(random_force(1.0, 200.0, 3e3, time[-1], seed), time)
    chain = build_chain(1, Duffing(), m=[1.0], c=[30.0], k=[1.1 * k], kappa=[4.0 * k])
    return chain, measured(true, moved, {"displacement": (1,)}, 55.0, seed)


@pytest.mark.slow
@pytest.mark.parametrize(("quadratic", "widest"), [(0.0, 1.5), (0.05, 5.0)])
def test_bands_of_a_circuit_hold_another_record_and_are_about_as_wide_as_the_error(quadratic, widest):
    """What a quadratic spring leaves out has other frequencies than the forces of the parameters, and acts again."""
    (chain, first), (_, second) = circuit(quadratic, 1), circuit(quadratic, 101)
    problem = StateParameter(unknown=["c_1", "k_1", "kappa_1"]).pose(chain, [first.record])
    found = by_spline(problem)
    own, structure = tuple(p.parameter for p in found.parameters), estimated_structure(chain, found.parameters)
    assert found.known is not None
    levels = replace(model().levels, step=first.record.step)
    given = Model(structure, own, found.known, levels, None, "sound", "", misfit=found.misfit)
    blank = np.full_like(second.truth.force, np.nan)
    new = replace(second.record, displacement=blank, responds=False)
    band = predicted(given, new, draws=60)
    for quantity in ("displacement", "velocity"):
        off, std = getattr(band.response, quantity) - getattr(second.truth, quantity), getattr(band.std, quantity)
        off, std = off[200:], std[200:]  # what the force does before its second sample is hardly known, and has decayed
        assert np.mean(np.abs(off) < 1.645 * std) > 0.75
        assert 0.6 < np.sqrt(np.mean(std**2) / np.mean(off**2)) < widest


def test_noise_of_a_measured_ground_and_what_a_channel_shows_of_it():
    rng = np.random.default_rng(0)
    seen = force_alone(duration=4.0)
    still, moved = np.zeros_like(seen.force), rng.standard_normal(len(seen.time))
    seen = replace(seen, force=still, unforced=np.ones(3, dtype=bool), ground_acceleration=moved)
    known = model()
    known = replace(known, levels=replace(known.levels, sensors={"ground_acceleration": np.array([0.05])}))
    of_the_run = spread(known, seen)  # content up to the Nyquist frequency shows no noise
    slow = np.sin(3.0 * seen.time)
    noisy = replace(seen, ground_acceleration=slow + 0.1 * rng.standard_normal(len(moved)))
    assert spread(known, noisy) == pytest.approx(2.0 * of_the_run, rel=0.2)
    assert spread(known, replace(seen, ground_acceleration=slow)) < 0.02 * of_the_run


@pytest.mark.slow
def test_bands_go_on_to_the_end_of_a_long_record():
    """As the same bands of its beginning: 45 000 steps of integration, and peaks of all of it."""
    seen = force_alone(duration=180.0)
    found = predicted(model(0.01), seen, draws=20)
    assert np.isfinite(found.std.displacement).all()
    assert len(found.peaks) == 15


def test_what_is_no_prediction_is_refused():
    with pytest.raises(InputError, match="the directory of a finished run with scheme=predict"):
        Predict(None)
    with pytest.raises(InputError, match="a list of 3 numbers"):
        Predict(model(), start={"velocity": [1.0]})
    with pytest.raises(InputError, match="scheme.start"):
        Predict(model(), start="tomorrow")
    with pytest.raises(InputError, match="forces and the ground alone"):
        Predict(model()).pose(STRUCTURE, [record(1).record])
    still = replace(force_alone(), force=np.zeros((600, 3)), unforced=np.ones(3, dtype=bool))
    with pytest.raises(InputError, match="nothing moves the structure"):
        Predict(model()).pose(STRUCTURE, [still])
