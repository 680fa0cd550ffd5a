"""What is in doubt about the sensors: parameters like those of the structure, whatever the scheme."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from pinn_cli.record.gauge import Gauge
from pinn_cli.record.record import Record
from pinn_cli.settings.errors import InputError
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.quantities import CALIBRATION_UNITS, HIGH_PASS, OF_ONE_CHANNEL, UNITS


def calibrated_starts(record: Record, starts: Mapping[Parameter, float]) -> Record:
    """The record whose sensors' unknown gains and delays start where a screening has found them.

    Args:
        record: What was measured.
        starts: Where parameters start, those of the structure among them.
    """
    found: defaultdict[str, dict[str, float]] = defaultdict(dict)
    for parameter, value in starts.items():
        if parameter.kind in CALIBRATION_UNITS:
            found[parameter.label][parameter.kind] = value
    return record.started_at(found)


def sensor_parameters(record: Record) -> tuple[Parameter, ...]:
    """The calibrations that are not known, of every gauge of a record.

    Raises:
        InputError: No gain is known. Motions, forces and the noise found can then all be larger or smaller together.
    """
    gauges = record.gauges
    plain = any((record.sensors(q) & ~record.gauged(q)).any() for q in (*record.response_quantities, "force"))
    if gauges and not plain and not any(gauge.of("gain").is_known for gauge in gauges):
        allowed = "one channel at least whose gain is a number: the reference"
        hint = "with every gain in doubt nothing tells how large motions and forces are"
        raise InputError("data.channels", "gain in doubt on all", allowed, hint)
    return tuple(parameter for number, gauge in enumerate(gauges) for parameter in _in_doubt(gauge, number))


def calibrations(gauges: Sequence[Gauge]) -> dict[str, Tensor]:
    """Kind to the numbers of all gauges as they are known or believed, (gauges,); none without gauges."""
    if not gauges:
        return {}
    values = {kind: [gauge.of(kind).value for gauge in gauges] for kind in CALIBRATION_UNITS}
    return {kind: torch.tensor(of_kind, dtype=torch.float64) for kind, of_kind in values.items()}


def _in_doubt(gauge: Gauge, number: int) -> tuple[Parameter, ...]:
    """Of one gauge's calibration, those that are not known; ``number`` is its own among all gauges, from 0."""
    return tuple(
        Parameter(
            kind,
            number,
            prescribed=gauge.of(kind).value,
            prior_std=gauge.of(kind).std,
            unknown=gauge.of(kind).unknown,
            unit=UNITS[gauge.quantity] + unit if kind in OF_ONE_CHANNEL else unit,
            positive=kind == HIGH_PASS,
            label=gauge.name,
        )
        for kind, unit in CALIBRATION_UNITS.items()
        if not gauge.of(kind).is_known
    )
