"""What is in doubt about the sensors: parameters like those of the structure, whatever the scheme."""

from __future__ import annotations

from pinn_cli.record.record import Record
from pinn_cli.settings.errors import InputError
from pinn_cli.system.parameters import Parameter


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
    return tuple(parameter for number, gauge in enumerate(gauges) for parameter in gauge.parameters(number))
