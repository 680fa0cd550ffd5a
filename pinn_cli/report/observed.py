"""Which samples a run was given, as a digest: runs with the same one saw the same record through the same sensors."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.response import QUANTITIES, RESPONSE_QUANTITIES

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pinn_cli.record.record import Record


def observed_digest(records: Iterable[Record]) -> str:
    """SHA-256, in part, of the samples of every sensor of one record or more, and of what is known of the forces.

    A sensor with a calibration of its own counts by its samples, not by what they are believed to mean.
    """
    digest = hashlib.sha256()
    for record in records:
        _add(digest, "time", record.time)
        digest.update(f"{record.intersample} {record.frame}".encode())
        _add(digest, "unforced", record.unforced)
        for quantity in (*QUANTITIES, *record.response_quantities[len(RESPONSE_QUANTITIES) :]):
            measured = record.sensors(quantity) & ~record.gauged(quantity)
            _add(digest, quantity, measured)
            _add(digest, quantity, record.histories(quantity)[:, measured])
        for gauge in record.gauges:
            _add(digest, gauge.name, gauge.time)
            _add(digest, gauge.quantity, gauge.values)
    return digest.hexdigest()[:16]


def _add(digest: hashlib._Hash, name: str, values: np.ndarray) -> None:
    digest.update(f"{name} {values.shape}".encode())
    digest.update(np.ascontiguousarray(values).tobytes())
