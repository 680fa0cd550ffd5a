"""The estimated system left to itself, and on other data: its error, its band, its table, text and figure."""

from dataclasses import replace
from pathlib import Path

import legends
import numpy as np
import pandas as pd
import pytest
from small_estimates import make_estimate, parameter_estimate
from small_problems import accelerations, excitation, measured, small_chain

from pinn_cli.record.channel import Calibration, Channel
from pinn_cli.record.record import Measurements, Record, Truth
from pinn_cli.record.response import QUANTITIES, RESPONSE_QUANTITIES, Response
from pinn_cli.record.simulated import Noise
from pinn_cli.record.simulation import simulate
from pinn_cli.record.validation_data import ValidationRecord
from pinn_cli.report.figures.sensors import WITH_NOISE, WITHOUT_NOISE, validation_figure
from pinn_cli.report.fitness import FORMULAS, fitness_percent
from pinn_cli.report.free_run import REFERENCES, ValidationRun, free_run, free_run_table
from pinn_cli.report.text import free_run_text, validation_text
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing, Gap, Linear
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import Estimate, ParameterEstimate
from pinn_cli.training.noise_model import FoundNoise

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


def test_noise_of_the_force_and_a_poor_start_are_no_faults_of_the_parameters():
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
    velocity = truth.velocity.copy()
    velocity[0] += 0.3 * truth.velocity.std(axis=0)
    finding = free_run(structure, estimated(replace(truth, velocity=velocity)), measurements.record).finding
    assert "the estimated start explains it" in " ".join(finding.split())
    assert "warning" not in finding


@pytest.mark.parametrize(("wrong", "told"), [({}, ""), ({"k_3": 8.0}, "warning")])
def test_how_far_a_free_body_goes_as_a_whole_is_no_contradiction(wrong, told):
    structure = build_chain(3, Linear(), m=10.0, c=[0.0, 1.0, 1.0], k=[0.0, 15.0, 15.0])
    measurements = measured(structure, duration=24.0, samples=513)
    truth = measurements.truth.response
    drift = 3.0 * truth.velocity.std() * truth.time[:, None]
    drifting = replace(truth, displacement=truth.displacement + drift)
    assert free_run(structure, estimated(drifting, **wrong), measurements.record).finding.partition(":")[0] == told


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


def test_runs_that_are_too_short_to_tell_of_a_spring_excuse_nothing():
    """Ten of a twentieth of a period, with which a spring agrees to 96 % that is a third off."""
    structure = build_chain(1, Duffing(), m=10.0, c=0.1, k=15.0, kappa=100.0)
    measurements = measured(structure, duration=3.0, samples=300)
    estimate = estimated(measurements.truth.response, k_1=20.0)
    run = free_run(structure, estimate, measurements.record)
    assert run.finding.startswith("warning")
    assert not np.isnan(run.agreement)


def test_an_unstable_or_absurdly_stiff_system_is_a_finding():
    structure, measurements = small_chain(), measured(small_chain(), duration=40.0, samples=1025)
    estimate = estimated(measurements.truth.response, kappa_2=-1e6)
    run = free_run(structure, estimate, measurements.record)
    assert run.response is None
    assert run.finding.startswith("the structure is unstable: its free run overflows at ")
    table = free_run_table(run, estimate, measurements.record, measurements.truth.response)
    assert table[list(FORMULAS)].isna().all(axis=None)
    assert free_run_text(run, table) == run.finding
    structure = small_chain()
    measurements = measured(structure)
    run = free_run(structure, estimated(measurements.truth.response, k_3=1e12), measurements.record)
    assert run.response is not None  # implicit steps take any stiffness that its dampers can bear
    assert np.isfinite(run.response.displacement).all()
    assert "do not reproduce" in run.finding


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


Z = 1.6448536


def believed(structure, record, error: float, std: float, sigma: float = 0.0) -> Estimate:
    """Stiffnesses all off by a share, and how far they are believed to be."""
    parameters = [
        ParameterEstimate(p, v := (1 + error) * p.prescribed, s := std * p.prescribed, v - Z * s, v + Z * s)
        for p in structure.every_parameter()
        if p.kind == "k"
    ]
    n = structure.ndof
    levels = {"acceleration": sigma, "displacement": np.nan, "force": np.nan}
    noise = FoundNoise({quantity: np.full(n, level) for quantity, level in levels.items()})
    none = replace(make_estimate().estimate.std, **{q: np.zeros((len(record.time), n)) for q in RESPONSE_QUANTITIES})
    return replace(make_estimate().estimate, parameters=parameters, correlation=np.ones((n, n)), noise=noise, std=none)


def tried(error: float = 0.0, std: float = 0.05, nonlinearity: str = "duffing", sigma: float = 0.0):
    structure = small_chain(nonlinearity)
    measurements = measured(structure)
    record = measurements.record.keep({"acceleration": [1, 3]})
    random = np.random.default_rng(0)
    record = replace(record, acceleration=record.acceleration + sigma * random.standard_normal((257, 3)))
    estimate = believed(structure, record, error, std, sigma)
    data = ValidationRecord(record, 20, None)
    return structure, estimate, record, data


def run_of(changes: dict[str, object] | None = None, draws: np.ndarray | None = None, **settings) -> ValidationRun:
    """That of :func:`tried`, of an estimate with some changes."""
    structure, estimate, record, data = tried(**settings)
    return ValidationRun.of(structure, replace(estimate, **changes or {}), record, data, draws)


def test_the_right_system_makes_no_error():
    table = run_of().table
    assert table[["quantity", "dof", "unit", "begins"]].values.tolist() == [
        ["acceleration", 1, "m/s^2", "rest"], ["acceleration", 3, "m/s^2", "rest"],
    ]  # fmt: skip
    assert (table["samples"] == 257 - 20).all()
    assert (table["nmse_percent"] < 1e-4).all()
    assert (table["start_time"] == measured(small_chain()).record.time[20]).all()


def test_an_error_of_the_size_that_is_believed_lies_in_the_band():
    inside = []
    for error in (-0.08, -0.05, -0.02, 0.02, 0.05, 0.08):
        table = run_of(error=error).table
        assert table["nmse_percent"].between(0.05, 30.0).all()
        inside += table["inside_95_percent"].tolist()
    assert np.mean(inside) > 90.0
    assert (run_of(error=0.05, std=0.005).table["inside_95_percent"] < 50.0).all()


def test_the_discrepancy_and_the_load_cell_widen_the_band():
    plain, cells = run_of(std=1e-6), {"force": np.array([0.2, np.nan, np.nan])}
    wide, cell = (run_of({"noise": noise}, std=1e-6) for noise in (FoundNoise(cells, 0.1), FoundNoise(cells)))
    for dof in range(3):
        assert np.mean(wide.std.displacement[50:, dof]) > np.mean(cell.std.displacement[50:, dof])
        assert np.mean(cell.std.displacement[50:, dof]) > 10.0 * np.mean(plain.std.displacement[50:, dof])


def test_it_begins_where_the_estimate_was():
    structure = small_chain("linear")
    measurements = measured(structure)
    record, truth = measurements.record.keep({"acceleration": [2]}), measurements.truth.response
    estimate = replace(believed(structure, record, 0.0, 0.01), response=truth)
    later = replace(record, **{name: getattr(record, name)[100:] for name in ("time", *RESPONSE_QUANTITIES, "force")})
    run = ValidationRun.of(structure, estimate, record, ValidationRecord(later, 10, 100))
    assert run.table["begins"].tolist() == ["estimate"]
    assert run.table["nmse_percent"][0] < 1e-3
    from_rest = ValidationRun.of(structure, estimate, record, ValidationRecord(later, 10, None))
    assert from_rest.table["nmse_percent"][0] > 1.0
    uncertain = replace(estimate, std=replace(estimate.std, displacement=np.full((257, 3), 0.01)))
    wide = ValidationRun.of(structure, uncertain, record, ValidationRecord(later, 10, 100))
    np.testing.assert_allclose(wide.std.displacement[0], 0.01, rtol=0.35)


def test_a_load_cell_s_gain_that_was_found_is_used():
    structure, estimate, record, _ = tried()
    cell = Channel("f", "force", {0: 1.0}, record.time, 1.25 * record.force[:, 0],
                 {"gain": Calibration(1.0, 10.0, unknown=True)})  # fmt: skip
    shown = replace(record, force=1.25 * record.force, calibrated=(cell,))
    gain = ParameterEstimate(Parameter("gain", 0, 1.0, label="f"), 1.25, 0.001, 1.248, 1.252)
    parameters = [*estimate.parameters, gain]
    with_gain = replace(estimate, parameters=parameters, correlation=np.eye(4))
    run = ValidationRun.of(structure, with_gain, record, ValidationRecord(shown, 20, None))
    assert (run.table["nmse_percent"] < 1e-4).all()


def test_what_a_tilt_that_was_found_adds_is_no_error():
    structure = small_chain("duffing")
    measurements = measured(structure)
    record, truth = measurements.record.keep({"acceleration": [1, 3]}), measurements.truth.response
    felt = truth.acceleration[:, 0] + 3.0 * truth.displacement[:, 0]
    unknown = {"tilt": Calibration(0.0, 40.0, unknown=True)}
    tilts = Channel("a1", "acceleration", {0: 1.0}, record.time, felt, unknown)
    shown = replace(record, acceleration=np.where([True, False, False], tilts.measured[:, None], record.acceleration))
    tilt = ParameterEstimate(Parameter("tilt", 0, 0.0, label="a1"), 3.0, 0.001, 2.998, 3.002)
    estimate = believed(structure, record, 0.0, 0.01)
    found = replace(estimate, parameters=[*estimate.parameters, tilt], correlation=np.eye(4))
    data = ValidationRecord(replace(shown, calibrated=(tilts,)), 20, None)
    assert (ValidationRun.of(structure, found, record, data).table["nmse_percent"] < 1e-3).all()


def test_without_deviations_there_is_no_band():
    run = run_of({"correlation": None})
    assert run.std is None
    assert run.table[["band_rms", "inside_95_percent"]].isna().all(axis=None)
    assert "acceleration 3" in validation_text(run)
    assert "inside" not in validation_text(run).splitlines()[0]
    assert len(validation_figure(run).axes) == 4


def test_the_noise_of_a_sensor_that_was_held_out_is_unknown():
    noise = FoundNoise({"acceleration": np.array([0.1, np.nan, np.nan])})
    figure = validation_figure(run_of({"noise": noise}, sigma=0.1))
    assert legends.texts(figure)[-2:] == [WITH_NOISE, WITHOUT_NOISE]
    assert legends.fit(figure)


def test_a_system_that_runs_away_is_told():
    structure, estimate, record, data = tried(error=-3.0)
    run = ValidationRun.of(structure.linearised(), estimate, record, data)
    stiff = ValidationRun.of(structure, believed(structure, record, 1e9, 0.01), record, data)
    assert stiff.response is None
    assert "too stiff" in validation_text(stiff)
    assert run.finding == "" or "unstable" in run.finding


@pytest.mark.parametrize("draws", [30, 500])
def test_draws_of_a_posterior_make_the_band(draws):
    values = np.array([p.estimate for p in tried()[1].parameters])
    wide = values * (1.0 + 0.1 * np.random.default_rng(0).standard_normal((draws, 1)))
    ratio = np.mean(run_of(draws=wide).std.displacement[50:]) / np.mean(run_of().std.displacement[50:])
    assert 1.4 < ratio < 2.8
