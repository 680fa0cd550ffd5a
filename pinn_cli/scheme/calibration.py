"""What is in doubt about the sensors: parameters like those of the structure, whatever the scheme."""

from __future__ import annotations

from pinn_cli.record.gauge import Gauge
from pinn_cli.record.record import Record
from pinn_cli.settings.errors import InputError
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.quantities import CALIBRATION_UNITS, UNITS


def sensor_parameters(record: Record) -> tuple[Parameter, ...]:
    """The calibrations that are not known, of every gauge of a record.

    Raises:
        InputError: No gain is known or believed: the scale of motions and forces cannot be told then.
    """
    gauges = record.gauges
    plain = any((record.sensors(q) & ~record.gauged(q)).any() for q in (*record.response_quantities, "force"))
    if gauges and not plain and all(gauge.of("gain").unknown for gauge in gauges):
        hint = "with every gain unknown nothing tells how large motions and forces are"
        raise InputError("data.channels", "gain: unknown on all", "one gain at least that is known or believed", hint)
    return tuple(parameter for number, gauge in enumerate(gauges) for parameter in _in_doubt(gauge, number))


def _in_doubt(gauge: Gauge, number: int) -> tuple[Parameter, ...]:
    """Of one gauge's calibration, those that are not known; ``number`` is its own among all gauges, from 0."""
    return tuple(
        Parameter(
            kind,
            number,
            prescribed=gauge.of(kind).value,
            prior_std=gauge.of(kind).std,
            unknown=gauge.of(kind).unknown,
            unit=unit if kind in ("gain", "delay") else UNITS[gauge.quantity] + unit,
            title=kind.capitalize(),
            label=gauge.name,
        )
        for kind, unit in CALIBRATION_UNITS.items()
        if not gauge.of(kind).is_known
    )
