"""A channel of a good record is ruined, or a structure is wrong: the fault is named, with its size, and no other."""

from dataclasses import replace

import numpy as np
import pytest
from frame_records import altered, measure
from small_problems import small_chain

from pinn_cli.record.channels import channels
from pinn_cli.record.free_run import free_run
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.parameters import Parameter
from pinn_cli.verdict.causes import causes
from pinn_cli.verdict.channel_faults import channel_faults
from pinn_cli.verdict.prediction import predicted


def faults(structure, record, excused=()):
    prediction = predicted(structure, record)
    assert prediction is not None
    return channel_faults(prediction, excused)


def test_a_good_record_has_none(frame, frame_record):
    """Nor has one with much noise or little, of other sensors, or that begins in motion."""
    noisy = [measure(frame, snr_db) for snr_db in (10.0, 60.0)]
    others = [measure(frame, quantity=quantity) for quantity in ("displacement", "velocity")]
    names = ("time", "acceleration", "force", "displacement", "velocity")
    later = replace(frame_record, **{name: getattr(frame_record, name)[500:] for name in names})
    for record in (frame_record, *noisy, *others, later):
        assert faults(frame, record) == []


def other(x):
    return np.random.default_rng(1).normal(size=len(x))


def elsewhere(record):
    """Its sensor on the first floor stands on the second one."""
    return altered(record.keep({"acceleration": (1, 3)}), 1, lambda _: record.acceleration[:, 1])


SECOND, ROOF = "acceleration of DOF 2", "force of DOF 3"
RUINED = [
    (lambda r: altered(r, 2, lambda x: x / 9.80665), "unit", SECOND, "1/9.80665"),
    (lambda r: altered(r, 2, lambda x: 1.15 * x), "gain", SECOND, "1.1"),
    (lambda r: altered(r, 2, lambda x: -x), "sign", SECOND, "multiply it by -1"),
    (lambda r: altered(r, 2, lambda x: np.roll(x, 3)), "delay", SECOND, "samples) late"),
    (lambda r: altered(r, 2, lambda x: x + 0.5 * x.std()), "offset", SECOND, "50 % of its rms"),
    (lambda r: altered(r, 2, other), "sensor", SECOND, ""),
    (
        lambda r: replace(r, acceleration=r.acceleration[:, [2, 1, 0]]),
        "swap",
        "acceleration of DOFs 1 and 3",
        "1 and 3",
    ),
    (elsewhere, "misplaced", "acceleration of DOF 1", "fits DOF 2"),
    # All channels say the same of the force; a lone one and the force may be wrong, either.
    (lambda r: replace(r, force=r.force / 1000.0), "unit", ROOF, ""),
    (lambda r: replace(r, force=np.roll(r.force, 4, axis=0)), "delay", ROOF, ""),
    (
        lambda r: altered(r.keep({"acceleration": [1]}), 1, lambda x: 2.0 * x),
        "gain",
        "acceleration of DOF 1",
        "the force",
    ),
]


@pytest.mark.parametrize(("ruin", "kind", "suspect", "told"), RUINED)
def test_a_ruined_channel_is_named_with_what_ruined_it(frame, frame_record, ruin, kind, suspect, told):
    (found,) = faults(frame, ruin(frame_record))
    assert (found.kind, found.suspect) == (kind, suspect)
    assert told in found.text


def test_what_leaves_most_of_the_misfit_is_no_cause(frame, frame_record):
    """A law that is left out turns phases, as a delay does, and leaves more than that."""

    def changed(x):
        turned = np.fft.irfft(np.fft.rfft(x) * np.exp(0.1j), len(x))
        return turned + 0.1 * x.std() * np.random.default_rng(0).standard_normal(len(x))

    assert faults(frame, altered(frame_record, 2, changed)) == []
    gain = altered(frame_record, 2, lambda x: 1.15 * x)
    assert faults(frame.with_parameters(k=frame.parameters["k"] * 1.3), gain) == []  # of a wrong structure
    assert faults(frame, gain, [SECOND]) == []  # of a channel that is excused


def test_a_nonlinear_chain_is_simulated():
    structure = small_chain("duffing", 3)
    record = measure(structure, strength=2.0)
    assert faults(structure, record) == []
    (found,) = faults(structure, altered(record, 3, lambda x: 1.15 * x))
    assert (found.kind, found.suspect) == ("gain", "acceleration of DOF 3")


def left_over(prediction, channel):
    """Of the channel, once the response and free decays are taken out, relative."""
    basis = prediction.decays(channel)
    residual = channel.measured - channel.of(prediction.response)
    residual = residual - basis @ (basis.T @ residual)
    return np.linalg.norm(residual) / np.linalg.norm(channel.measured)


@pytest.mark.parametrize("quantity", ["displacement", "velocity", "acceleration"])
@pytest.mark.parametrize("start", [None, ([0.1, 0.2, -0.1], [0.0, 0.3, 0.0])], ids=["rest", "elsewhere"])
def test_the_response_is_that_of_a_simulation_up_to_free_decays(frame, quantity, start):
    record = measure(frame, None, quantity=quantity)
    prediction = predicted(frame, record, start)
    assert all(left_over(prediction, channel) < 1e-5 for channel in channels(record))


def test_a_held_force_has_a_prediction_and_free_motion_that_grows_has_none(frame):
    record = replace(measure(frame, None), intersample="zero_order_hold")
    record = replace(record, acceleration=free_run(frame, record).acceleration)
    assert all(left_over(predicted(frame, record), c) < 1e-9 for c in channels(record))
    assert predicted(frame.with_parameters(c=-0.1 * frame.parameters["c"]), record) is None


@pytest.fixture
def problem(frame, frame_record):
    """A frame whose stiffnesses are right."""
    return Problem(frame, frame_record, ())


@pytest.fixture
def from_afar(frame, frame_record):
    """The same whose stiffnesses are unknown, and started 5 times too low."""
    unknown = tuple(Parameter("k", dof, 3.0, 30.0, unknown=True, positive=True) for dof in range(3))
    return Problem(frame.with_parameters(k=frame.parameters["k"] / 5.0), frame_record, unknown)


def found(problem, excused=()):
    return causes(problem, problem.structure, problem.structure, excused)


THIRD = "acceleration of DOF 3"


def turned(record):
    return altered(record, 3, lambda x: -x)


@pytest.mark.parametrize(
    ("ruin", "kind", "suspect"),
    [
        (lambda r: altered(r, 3, lambda x: x / 9.80665), "unit", THIRD),
        (lambda r: altered(r, 3, lambda x: 3.0 * x), "gain", THIRD),
        (turned, "sign", THIRD),
        (lambda r: altered(r, 3, lambda x: np.roll(x, 3)), "delay", THIRD),
        (lambda r: replace(r, acceleration=r.acceleration[:, [2, 1, 0]]), "swap", "acceleration of DOFs 1 and 3"),
    ],
)
def test_the_cause_of_a_ruined_record(problem, ruin, kind, suspect):
    (cause,) = found(replace(problem, record=ruin(problem.record)))
    assert (cause.kind, cause.suspect) == (kind, suspect)


def test_no_cause_is_made_up(problem):
    """For a good record, a channel that is excused, or a structure that is released and has no spectra to compare."""
    assert found(problem) == []
    excused = found(replace(problem, record=turned(problem.record)), [THIRD])
    assert all(cause.suspect != THIRD for cause in excused)
    released = replace(problem.record, force=np.zeros_like(problem.record.force))
    assert found(replace(problem, record=released)) == []


@pytest.mark.slow
def test_causes_beside_stiffnesses_that_are_unknown(from_afar):
    assert found(from_afar) == []
    (cause,) = found(replace(from_afar, record=turned(from_afar.record)))
    assert (cause.kind, cause.suspect) == ("sign", "acceleration of DOF 3")
    m = from_afar.structure.parameters["m"].clone()
    m[1] *= 0.5
    (cause,) = found(replace(from_afar, structure=from_afar.structure.with_parameters(m=m)))
    assert (cause.kind, cause.suspect) == ("mass", "m_2")


def test_a_sensor_that_is_still_and_excused_hides_no_other_one(problem):
    spoilt = altered(turned(problem.record), 2, lambda x: 0.0 * x)
    (cause,) = found(replace(problem, record=spoilt), ["acceleration of DOF 2"])
    assert (cause.kind, cause.suspect) == ("sign", "acceleration of DOF 3")


@pytest.mark.slow
def test_exchanged_sensors_that_led_the_estimate_astray(from_afar):
    k = from_afar.structure.parameters["k"]
    astray = from_afar.structure.with_parameters(k=k * k.new_tensor([1e-3, 50.0, 200.0]))
    record = replace(from_afar.record, acceleration=from_afar.record.acceleration[:, [2, 1, 0]])
    (cause,) = causes(replace(from_afar, record=record), from_afar.structure, astray)
    assert (cause.kind, cause.suspect) == ("swap", "acceleration of DOFs 1 and 3")


def test_a_sign_that_led_the_search_and_its_start_astray(from_afar):
    k = from_afar.structure.parameters["k"]
    astray = from_afar.structure.with_parameters(k=5.0 * k * k.new_tensor([50.0, 0.05, 0.02]))
    spoilt = replace(from_afar, structure=astray, record=altered(from_afar.record, 1, lambda x: -x))
    (cause,) = found(spoilt)
    assert (cause.kind, cause.suspect) == ("sign", "acceleration of DOF 1")


@pytest.mark.parametrize(("dof", "factor"), [(1, 5.0), (2, 0.5)])
def test_a_wrong_mass_and_wrong_dampers(problem, dof, factor):
    m = problem.structure.parameters["m"].clone()
    m[dof - 1] *= factor
    (cause,) = found(replace(problem, structure=problem.structure.with_parameters(m=m)))
    assert (cause.kind, cause.suspect) == ("mass", f"m_{dof}")
    assert abs(float(cause.text.split()[3]) - 10.0) < 0.5
    wrong = problem.structure.with_parameters(c=10.0 * problem.structure.parameters["c"])
    (cause,) = found(replace(problem, structure=wrong))
    assert cause.kind == "damping"


@pytest.mark.parametrize(("scale", "told"), [(1e3, "milliseconds"), (1 / 60, "minutes")])
def test_a_time_axis_in_another_unit(frame, frame_record, scale, told):
    (cause,) = found(Problem(frame, replace(frame_record, time=frame_record.time * scale), ()))
    assert (cause.kind, cause.word) == ("time_unit", "failed")
    assert told in cause.text


def test_a_structure_that_is_wrong_in_many_ways_has_no_one_cause(frame, frame_record):
    wrong = frame.with_parameters(k=frame.parameters["k"] * frame.parameters["k"].new_tensor([0.3, 3.0, 0.2]))
    assert found(Problem(wrong, frame_record, ())) == []
