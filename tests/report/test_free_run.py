"""The estimated system left to itself: right parameters reproduce the truth, wrong ones are found out."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from small_estimates import parameter_estimate
from small_problems import accelerations, excitation, measured, small_chain

from pinn_cli.record.record import Measurements, Record, Truth
from pinn_cli.record.response import QUANTITIES, RESPONSE_QUANTITIES, Response
from pinn_cli.record.simulated import Noise
from pinn_cli.record.simulation import simulate
from pinn_cli.report.fitness import FORMULAS, fitness_percent
from pinn_cli.report.free_run import REFERENCES, free_run, free_run_table
from pinn_cli.report.text import free_run_text
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing, Gap
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import Estimate

SIGNALS = Path(__file__).resolve().parents[3] / "shared" / "data" / "reference_signals"


def estimated(response: Response, **parameters: float) -> Estimate:
    """An estimate of this motion and these parameters."""
    nan = float("nan")
    found = [parameter_estimate(name, nan, value, nan, nan, nan) for name, value in parameters.items()]
    unknown = Response.unknown(response.time, response.force.shape[1])
    return Estimate(response, unknown, found, pd.DataFrame(), {})


def largest_error(response: Response, truth: Response, quantities: tuple[str, ...] = RESPONSE_QUANTITIES) -> float:
    """Over time, DOFs and quantities, relative to each quantity's largest value."""
    pairs = [(getattr(response, quantity), getattr(truth, quantity)) for quantity in quantities]
    return max(float(np.max(np.abs(x - true)) / np.max(np.abs(true))) for x, true in pairs)


def from_sample(measurements: Measurements, first: int) -> tuple[Record, Response]:
    """Record and truth without their first samples: they begin neither at 0 s nor at rest."""

    def cut(histories: Record | Response) -> dict[str, np.ndarray]:
        return {name: getattr(histories, name)[first:] for name in ("time", *QUANTITIES)}

    record, truth = measurements.record, measurements.truth.response
    return replace(record, **cut(record)), Response(**cut(truth))


def measured_exactly(structure: Structure, hold: str) -> Measurements:
    """A linear structure by a method of order eight: its free run is exact, and the simulator's steps are not."""
    found = measured(structure, hold)
    if structure.nonlinearity_name != "linear":
        return found
    response = simulate(structure, excitation(structure).force, found.record.time, hold, "dop853")
    return replace(found, record=replace(found.record, **response.measurable), truth=Truth(response, {}))


# A held force is known exactly. A spline through 257 samples knows the other kind to 1e-5 (8 samples per period).
@pytest.mark.parametrize(("hold", "tolerance"), [("exact", 1e-5), ("zero_order", 1e-12)])
@pytest.mark.parametrize("first", [0, 50])
@pytest.mark.parametrize("nonlinearity", ["linear", "duffing", "van_der_pol"])
def test_the_true_system_reproduces_the_truth(hold, tolerance, first, nonlinearity):
    structure = small_chain(nonlinearity)
    record, truth = from_sample(measured_exactly(structure, hold), first)
    run = free_run(structure, estimated(truth), record)
    assert run.response is not None
    assert run.finding == ""
    assert largest_error(run.response, truth) < tolerance
    table = free_run_table(run, estimated(truth), record, truth)
    assert table["fitness_percent"].min() > 99.99


def test_the_authors_system_reproduces_their_signals():
    if not SIGNALS.is_dir():
        pytest.skip(f"the reference signals are not at {SIGNALS}")
    signals = dict(np.load(SIGNALS / "sp_5dof.npz"))
    truth = Response(**{name: signals[name] for name in ("time", *QUANTITIES)})
    unforced = ~truth.force.any(axis=0)
    record = Record(**truth.measurable, unforced=unforced, intersample="zero_order_hold")
    # Prescribed are parameters that are far off: all of the true ones come in as estimates.
    prescribed = build_chain(5, Duffing(), m=3.0, c=3.0, k=3.0, kappa=3.0)
    estimates = {f"{name}_{i + 1}": signals[name][i] for name in ("m", "c", "k", "kappa") for i in range(5)}
    run = free_run(prescribed, estimated(truth, **estimates), record)
    assert run.response is not None
    assert run.finding == ""
    assert largest_error(run.response, truth) < 1e-9


@pytest.mark.parametrize("hold", ["exact", "zero_order"])
def test_wrong_stiffness_is_found_out(hold):
    structure = small_chain()
    measurements = measured(structure, hold, duration=24.0, samples=513)
    truth = measurements.truth.response
    estimate = estimated(truth, k_1=18.0, k_2=18.0, k_3=18.0)
    run = free_run(structure, estimate, measurements.record)
    assert run.response is not None
    assert run.finding.startswith("warning")
    text = free_run_text(run, free_run_table(run, estimate, measurements.record, truth))
    assert run.finding in " ".join(text.split())


def with_noisy_force(measurements: Measurements, snr_db: float) -> Record:
    return replace(measurements.record, force=Noise(snr_db, seed=3).added_to(measurements.truth.response).force)


def test_the_noise_of_the_force_is_no_fault_of_the_parameters():
    structure = small_chain()
    measurements = measured(structure, duration=24.0, samples=513)
    truth = measurements.truth.response
    assert free_run(structure, estimated(truth), with_noisy_force(measurements, 20.0)).finding == ""
    # A free run under more noise than signal is another motion altogether.
    finding = free_run(structure, estimated(truth), with_noisy_force(measurements, -10.0)).finding
    assert "warning" not in finding
    assert "2.391 s on, to 100.0 %" in finding
    # The noise excuses nothing but itself.
    stiff = estimated(truth, k_1=18.0, k_2=18.0, k_3=18.0)
    assert free_run(structure, stiff, with_noisy_force(measurements, -10.0)).finding.startswith("warning")


def test_a_poor_start_is_no_fault_of_the_parameters():
    structure = small_chain()
    measurements = measured(structure, duration=24.0, samples=513)
    truth = measurements.truth.response
    velocity = truth.velocity.copy()
    velocity[0] += 0.3 * truth.velocity.std(axis=0)
    finding = free_run(structure, estimated(replace(truth, velocity=velocity)), measurements.record).finding
    assert "the estimated start explains it" in " ".join(finding.split())
    assert "warning" not in finding


@pytest.mark.parametrize(
    ("law", "wrong", "beside", "told"),
    [
        (Gap(), {}, 1e-4, "chaotic"),
        (Duffing(), {"k_1": 18.0}, 1e-4, "warning"),
        (Duffing(), {"k_1": 18.0}, 0.05, "warning"),
    ],
)
def test_of_a_chaotic_motion_no_free_run_tells_anything(law, wrong, beside, told):
    own = {"k": 0.0, "k_g": 500.0, "gap": 0.1} if isinstance(law, Gap) else {"k": 15.0, "kappa": 100.0}
    structure = build_chain(1, law, m=10.0, c=0.1, **own)
    measurements = measured(structure, duration=60.0, samples=1500)
    truth = measurements.truth.response
    one = np.full_like(truth.displacement, beside)
    std = replace(truth, displacement=one, velocity=one)
    begun = replace(truth, displacement=truth.displacement + 1e-4)
    run = free_run(structure, replace(estimated(begun, **wrong), std=std), measurements.record)
    assert told in run.finding
    assert np.isnan(run.agreement) == (told == "chaotic")


def test_an_unstable_system_is_a_finding():
    structure, measurements = small_chain(), measured(small_chain(), duration=40.0, samples=1025)
    estimate = estimated(measurements.truth.response, kappa_2=-1e6)
    run = free_run(structure, estimate, measurements.record)
    assert run.response is None
    assert run.finding.startswith("the structure is unstable: its free run overflows at ")
    table = free_run_table(run, estimate, measurements.record, measurements.truth.response)
    assert table[list(FORMULAS)].isna().all(axis=None)
    assert free_run_text(run, table) == run.finding


def test_the_table_scores_against_truth_sensors_and_estimate():
    structure = small_chain()
    measurements = measured(structure, snr_db=20.0)
    record, truth = accelerations(measurements.record, (1, 3)), measurements.truth.response
    estimate = estimated(replace(truth, displacement=1.1 * truth.displacement))
    run = free_run(structure, estimate, record)
    table = free_run_table(run, estimate, record, truth)
    assert list(table) == ["against", "group", "quantity", *FORMULAS]
    assert tuple(dict.fromkeys(table["against"])) == REFERENCES
    assert set(table["quantity"]) == set(RESPONSE_QUANTITIES)

    cells = table.set_index(["against", "group", "quantity"])["fitness_percent"]
    for name, reference in (("truth", truth), ("estimate", estimate.response)):
        expected = fitness_percent(run.response.displacement, reference.displacement).mean()
        assert cells[name, "all", "displacement"] == pytest.approx(expected)
    sensors = cells["sensors"]
    both = [sensors["dof_1", "acceleration"], sensors["dof_3", "acceleration"]]
    assert sensors["all", "acceleration"] == sensors["observed", "acceleration"] == pytest.approx(np.mean(both))
    assert all(np.isnan(sensors[place]) for place in (("dof_2", "acceleration"), ("all", "displacement")))


def test_an_absurdly_stiff_estimate_does_not_hold_up_the_report():
    structure = small_chain()
    measurements = measured(structure)
    run = free_run(structure, estimated(measurements.truth.response, k_3=1e12), measurements.record)
    assert run.response is not None  # implicit steps take any stiffness that its dampers can bear
    assert np.isfinite(run.response.displacement).all()
    assert "do not reproduce" in run.finding
