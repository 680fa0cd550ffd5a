"""``data.channels``: what every key means, and what a value that cannot be meant says in one line."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from calls import refusal

from pinn_cli.record.channel import CALIBRATED
from pinn_cli.record.data_channels import DataChannel, data_channels
from pinn_cli.record.measured_data import MeasuredData
from pinn_cli.record.record import Record
from pinn_cli.settings.errors import InputError
from pinn_cli.system.quantities import MOTION

STEP, ROWS = 0.01, 200
TIME = np.round(STEP * np.arange(ROWS), 2)
A1, A2, U, F = np.sin(20 * TIME), np.cos(13 * TIME), 1e-3 * np.sin(9 * TIME), 500 * np.cos(7 * TIME)
FLOOR, ROOF = ({"sensor": "acceleration", "dof": dof} for dof in (1, 2))


@pytest.fixture
def rig(tmp_path) -> Path:
    columns = {"t": TIME, "a1": A1, "a2": A2, "u": U, "f": F}
    pd.DataFrame(columns).to_csv(tmp_path / "rig.csv", index=False)
    return tmp_path


def record_of(base: Path, connections: tuple[str, ...] = (), **channels: Any) -> Record:
    return measured(base, channels).measure(3, connections).record


def measured(base: Path, channels: Any, **settings: Any) -> MeasuredData:
    return MeasuredData("rig.csv", channels=channels, base=base, **settings)


def one(**keys: Any) -> DataChannel:
    (channel,) = data_channels({"x": keys})
    return channel


def test_every_key(rig):
    record = record_of(
        rig,
        ("storey", "brace"),
        roof={"sensor": "acceleration", "dof": "2", "column": "a1", "unit": "g"},
        u={"sensor": "displacement", "between": [2, 1], "unit": "mm"},
        a2={"sensor": "connection_force", "connection": 2, "unit": "kN"},
        f={"sensor": "force", "dof": 3, "unit": "kN", "gain": "unknown", "delay": {"value": 0.01, "uncertainty": 0.02}},
    )
    np.testing.assert_allclose(record.acceleration[:, 1], 9.80665 * A1)
    drift, brace, force = record.calibrated
    assert (drift.key, drift.quantity, drift.weights, drift.is_column) == ("u", MOTION[0], {1: 1.0, 0: -1.0}, False)
    np.testing.assert_allclose(drift.measured, 1e-3 * U)
    assert (brace.quantity, brace.connection, brace.weights) == ("connection_force", 1, {})
    np.testing.assert_allclose(brace.measured, 1e3 * A2)
    assert force.place == ("force", 2)
    gain, delay = force.number("gain"), force.number("delay")
    assert (gain.value, gain.unknown, gain.std > 1) == (1.0, True, True)
    assert (delay.value, delay.std, delay.unknown) == (0.01, 0.02, False)
    assert record.unforced.tolist() == [True, True, False]
    np.testing.assert_allclose(record.force[:, 2], 1e3 * np.interp(TIME + 0.01, TIME, F))


def test_short_and_long_form_are_the_same_record(rig):
    short = MeasuredData("rig.csv", force={3: "f"}, acceleration={1: "a1", 2: "a2"}, base=rig).measure(3).record
    force, roof = {"sensor": "force", "dof": 3}, {**ROOF, "column": "a2"}
    long = record_of(rig, f=force, a1=FLOOR, roof=roof)
    for quantity in ("time", "force", "acceleration", "velocity", "displacement"):
        np.testing.assert_array_equal(getattr(long, quantity), getattr(short, quantity))
    assert long.calibrated == ()


@pytest.mark.parametrize(
    ("sensor", "unit", "factor"),
    [
        ("acceleration", "g", 9.80665),
        ("ground_acceleration", "gal", 1e-2),
        ("acceleration", "cm/s^2", 1e-2),
        ("displacement", "1e-6", 1e-6),
        ("displacement", "in", 0.0254),
        ("force", "lbf", 4.4482216152605),
        ("connection_force", "kN", 1e3),
    ],
)
def test_units(sensor, unit, factor):
    place = {"ground_acceleration": {}, "connection_force": {"connection": 1}}.get(sensor, {"dof": 1})
    assert one(sensor=sensor, unit=unit, **place).factor == pytest.approx(factor)


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"unit": "furlonk"}, "data.channels.x.unit=furlonk"),
        ({"unit": "mm"}, "mm measures [length], and the channel's sensor is one of acceleration"),
        ({"unit": "__import__('os')"}, "data.channels.x.unit=__import__('os')"),
        ({"unit": True}, "data.channels.x.unit=True"),
        ({"sensor": "acelerometer"}, "data.channels.x.sensor=acelerometer: must be"),
        ({"gian": "unknown"}, "gain"),
        ({"high_pass": 0.0}, "data.channels.x.high_pass=0.0"),
        ({"high_pass": {"frequency": 0.5, "order": 3}}, "must be a corner in Hz, or {frequency: 0.5, order: 1 or 2}"),
        ({"sensor": "displacement", "high_pass": 1.0}, "data.channels.x.high_pass=1.0"),
        ({"sensor": "velocity", "tilt": "unknown"}, "data.channels.x.tilt=unknown"),
        ({"dof": 0}, "data.channels.x.dof=0"),
        ({"dof": None}, "data.channels.x={}: must be one of dof, between, weights, support with"),
        ({"sensor": "ground_acceleration"}, "data.channels.x={dof: 1}: must be no dof, between"),
        (
            {"sensor": "force", "dof": None, "weights": {1: 1.0}},
            "data.channels.x={weights: {1: 1.0}}: must",
        ),
        ({"sensor": "connection_force"}, "data.channels.x={dof: 1}: must be one of connection"),
        ({"between": [1, 2]}, "data.channels.x={dof: 1, between: [1, 2]}"),
        ({"dof": None, "between": [1, 1]}, "data.channels.x.between=[1, 1]"),
        ({"dof": None, "weights": {1: "a"}}, "data.channels.x.weights.1=a"),
        ({"dof": None, "weights": {1: 0.0}}, "data.channels.x.weights={1: 0.0}"),
        ({"dof": None, "weights": {1: 1.0, "1": 2.0}}, "data.channels.x.weights={1: 1.0, '1': 2.0}"),
        ({"dof": None, "support": "a"}, "data.channels.x.support=a"),
        ({"dof": None, "support": 1, "gain": "unknown"}, "data.channels.x.gain=unknown"),
        ({"column": 3}, "data.channels.x.column=3"),
        ({"gain": 0}, "data.channels.x.gain=0"),
        ({"offset": {"value": 1, "uncertainty": -1}}, "data.channels.x.offset.uncertainty=-1"),
        ({"drift": [1, 2]}, "data.channels.x.drift=[1, 2]"),
    ],
)
def test_what_cannot_be_meant(keys, expected):
    given = {"sensor": "acceleration", "dof": 1} | keys
    assert expected in refusal(one, **given)


def test_what_is_no_map():
    assert data_channels(None) == data_channels({}) == ()
    for given, named in ((["a1"], "data.channels="), ({"a1": 1}, "data.channels.a1=1"), ("a1", "data.channels=a1")):
        assert refusal(data_channels, given).startswith(named)


@pytest.mark.parametrize(
    ("place", "weights"),
    [
        ({"between": [2, 1]}, {1: 1.0, 0: -1.0}),
        ({"between": [2, "ground"]}, {1: 1.0}),
        ({"between": [0, 2]}, {1: -1.0}),
        ({"weights": {1: 0.4, "2": -0.2}}, {0: 0.4, 1: -0.2}),
        ({"dof": 3}, {2: 1.0}),
    ],
)
def test_what_a_sensor_feels(place, weights):
    channel = one(sensor="displacement", **place).sensor
    assert channel.weights == weights
    assert channel.is_column == (list(weights.values()) == [1.0])
    assert channel.place == (("displacement", max(weights)) if channel.is_column else (CALIBRATED, 0))


def test_a_filter_has_a_corner_and_an_order(rig):
    shown = {"high_pass": {"frequency": "unknown", "order": 2}, "tilt": {"value": 0.0, "uncertainty": 2.0}}
    (channel,) = record_of(rig, a1={**ROOF, **shown}, f={"sensor": "force", "dof": 2}).calibrated
    assert (channel.filter_order, channel.number("high_pass").unknown, channel.number("tilt").std) == (2, True, 2.0)
    (channel,) = record_of(rig, a1={**ROOF, "high_pass": 0.5}, f={"sensor": "force", "dof": 2}).calibrated
    corner = channel.number("high_pass")
    assert (channel.filter_order, corner.value, corner.is_known) == (1, 0.5, True)


def test_what_is_known_of_a_calibration_is_taken_out(rig):
    """gain, offset and drift of a channel in its own unit: value = gain x + offset + drift (t - start)."""
    shown = {"sensor": "displacement", "dof": 1, "unit": "mm", "gain": 2.0, "offset": 0.5, "drift": -0.1}
    record = record_of(rig, u=shown)
    assert record.calibrated == ()
    np.testing.assert_allclose(record.displacement[:, 0], 1e-3 * (U - 0.5 + 0.1 * TIME) / 2.0, atol=1e-15)
    later = measured(rig, {"u": shown}, start=0.5).measure(1).record  # its drift counts from the window's start
    np.testing.assert_allclose(later.displacement[:, 0], record.displacement[50:, 0] - 1e-3 * 0.1 * 0.5 / 2.0)
    (late,) = record_of(rig, u={**shown, "delay": 0.02}).calibrated
    at, felt = late.corrected_samples()
    np.testing.assert_allclose(at, TIME - 0.02)
    np.testing.assert_allclose(felt, record.displacement[:, 0], atol=1e-15)


def test_two_sensors_of_one_dof(rig):
    record = record_of(rig, a1=ROOF, a2={**ROOF, "gain": 1.1})
    np.testing.assert_array_equal(record.acceleration[:, 1], A1)
    (second,) = record.calibrated
    assert (second.key, second.fills, second.is_column) == ("a2", False, False)
    assert record.plain("acceleration").tolist() == record.sensors("acceleration").tolist()
    np.testing.assert_allclose(second.corrected_samples()[1], A2 / 1.1)
    record = record_of(rig, a1={**ROOF, "offset": "unknown"}, a2=ROOF)  # the plain one, whatever the order
    np.testing.assert_array_equal(record.acceleration[:, 1], A2)
    assert [(channel.key, channel.fills) for channel in record.calibrated] == [("a1", False)]


@pytest.mark.parametrize(
    ("channels", "expected"),
    [
        ({"a1": {**ROOF, "delay": 2.5}}, "data.channels.a1.delay=2.5"),
        ({"a1": {**ROOF, "delay": {"value": -9, "uncertainty": 1}}}, "data.channels.a1.delay=-9"),
        ({"a1": {**ROOF, "dof": 4}}, "data.channels.a1=4"),
        ({"b": ROOF}, "data.channels.b='b'"),
        ({"a1": ROOF, "b": {**ROOF, "column": "a1"}}, "data.channels.b='a1'"),
        ({"t": ROOF}, "data.channels.t='t'"),
        ({"f": {"sensor": "force", "dof": 1}}, "{}: must be a map of DOF: column in at least one of them"),
        ({"u": {"sensor": "displacement", "between": [2, 1]}}, "data.channels=drifts and weighted sums only"),
        ({"a1": ROOF, "a2": {"sensor": "connection_force", "connection": "brce"}}, "data.channels.a2.connection=brce"),
        ({"a1": ROOF, "a2": {"sensor": "connection_force", "connection": 3}}, "data.channels.a2.connection=3"),
    ],
)
def test_what_does_not_fit_the_file_or_the_structure(rig, channels, expected):
    assert expected in refusal(record_of, rig, ("storey", "brace"), **channels)


def test_the_header_tells_the_unit_where_nobody_else_does():
    channel = one(sensor="acceleration", dof=1)
    assert channel.in_unit("g").factor == pytest.approx(9.80665)
    assert channel.in_unit("").factor == 1.0
    assert one(sensor="acceleration", dof=1, unit="mg").in_unit("g").factor == pytest.approx(9.80665e-3)
    for header in ("volts", "V", "mm"):
        assert refusal(channel.in_unit, header).endswith(f"its header says '{header}'")


class TestHoldout:
    """A DOF that is held out scores the estimate: only by what was measured there."""

    def measured(self, rig: Path, more: dict | None = None, **keys: Any):
        channels = {"a1": FLOOR, "a2": {**ROOF, **keys}, **(more or {})}
        return measured(rig, channels, holdout=[2]).measure(3)

    def test_a_known_calibration_is_taken_out(self, rig):
        truth = self.measured(rig, unit="g", gain=2.0).truth.response
        np.testing.assert_allclose(truth.acceleration[:, 1], 9.80665 * A2 / 2.0)

    @pytest.mark.parametrize("keys", [{"gain": "unknown"}, {"delay": 0.01}, {"offset": {"value": 0, "uncertainty": 1}}])
    def test_what_nobody_can_calibrate_is_refused(self, rig, keys):
        assert refusal(self.measured, rig, **keys).startswith("data.holdout=[2]")

    def test_samples_that_are_missing_score_nothing(self, rig):
        table = pd.read_csv(rig / "rig.csv")
        table.loc[20:60, "a2"] = np.nan
        table.to_csv(rig / "rig.csv", index=False)
        found = self.measured(rig)
        assert found.record.calibrated == ()
        shown = found.truth.response.acceleration[:, 1]
        np.testing.assert_array_equal(np.isnan(shown), np.isnan(table["a2"]))
        np.testing.assert_array_equal(shown[61:], A2[61:])

    def test_a_second_sensor_of_the_dof_is_not_shown_either(self, rig):
        found = self.measured(rig, {"f": {**ROOF, "gain": 2.0}})
        assert found.record.calibrated == ()
        np.testing.assert_array_equal(found.truth.response.acceleration[:, 1], A2)

    def test_a_load_cell_of_the_dof_stays(self, rig):
        for calibration in ({}, {"gain": "unknown"}):
            found = self.measured(rig, {"f": {"sensor": "force", "dof": 2, **calibration}}).record
            assert np.isfinite(found.force[:, 1]).all()
            assert [channel.key for channel in found.calibrated] == (["f"] if calibration else [])

    def test_a_sensor_that_feels_another_dof_too_is_refused(self, rig):
        channels = {"a1": FLOOR, "u": {"sensor": "displacement", "between": [2, 1]}}
        with pytest.raises(InputError, match="channel u feels others too"):
            measured(rig, channels, holdout=[2]).measure(3)
