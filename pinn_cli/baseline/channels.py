"""What the smoother's sensors show at the record's times: samples that may be missing, and numbers in doubt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pinn_cli.baseline.discretisation import interpolated_force
from pinn_cli.record.gauge import GAUGE, Gauge
from pinn_cli.record.record import Record
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.settings.errors import InputError
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.quantities import CALIBRATION_UNITS, FORCE, TILT

# Part of a step by which a sample may be off the record's times.
ON_TIME = 0.01


@dataclass(frozen=True, eq=False)
class Channel:
    """One sensor: gain times what it feels, an offset and a drift.

    Attributes:
        quantity: What it measures.
        weights: DOF, counted from 0, to its weight in what it feels.
        shown: (N,), what it shows; 0 where it has no sample.
        there: (N,) bool, where it has one.
        since: (N,), time from which its drift counts, s.
        gauge: Its number among the record's gauges; None: what it shows is what it feels.
    """

    quantity: str
    weights: Mapping[int, float]
    shown: np.ndarray
    there: np.ndarray
    since: np.ndarray
    gauge: int | None = None

    def felt(self, motion: Mapping[str, np.ndarray]) -> np.ndarray:
        """(N,), of a motion: quantity to (N, n)."""
        each = [weight * motion[self.quantity][:, dof] for dof, weight in self.weights.items()]
        felt: np.ndarray = np.sum(each, axis=0)
        return felt

    def numbers(self, parameters: Mapping[str, np.ndarray]) -> tuple[float, np.ndarray]:
        """Its gain, and (N,) what it shows of nothing."""
        if self.gauge is None:
            return 1.0, np.zeros(len(self.shown))
        gain, offset, drift = (float(parameters[kind][self.gauge]) for kind in ("gain", "offset", "drift"))
        return gain, offset + drift * self.since

    def by_numbers(self, felt: np.ndarray, uncertain: tuple[Parameter, ...]) -> np.ndarray:
        """(N, p), change of what it shows with its own uncertain numbers, in prior standard deviations.

        Args:
            felt: (N,), what it feels.
            uncertain: All p uncertain parameters of the problem.
        """
        by_kind = {"gain": felt, "offset": np.ones_like(felt), "drift": self.since}
        columns = np.zeros((len(felt), len(uncertain)))
        for i, p in enumerate(uncertain):
            if p.kind in by_kind and self.gauge is not None and p.index == self.gauge:
                columns[:, i] = p.prior_std * by_kind[p.kind]
        return columns


def response_channels(record: Record) -> list[Channel]:
    """Of a record that :func:`check_gauges` passes: its columns, then its gauges."""
    out = []
    for quantity in RESPONSE_QUANTITIES:
        for dof in np.flatnonzero(record.sensors(quantity) & ~record.gauged(quantity)):
            column = getattr(record, quantity)[:, dof]
            everywhere = np.ones(len(column), dtype=bool)
            out.append(Channel(quantity, {int(dof): 1.0}, column, everywhere, record.time - record.time[0]))
    gauges = [(i, gauge) for i, gauge in enumerate(record.gauges) if gauge.quantity in RESPONSE_QUANTITIES]
    return out + [_of_gauge(number, gauge, record) for number, gauge in gauges]


class Loads:
    """The measured forces at and between the record's times, with what is found of their load cells.

    Args:
        record: What was measured.
        substeps: Of every step, see :func:`pinn_cli.baseline.discretisation.interpolated_force`.
    """

    def __init__(self, record: Record, substeps: int) -> None:
        cells = [_of_gauge(i, gauge, record) for i, gauge in enumerate(record.gauges) if gauge.quantity == FORCE]
        self.cells = {dof: cell for cell in cells for dof in cell.weights}
        shown = np.nan_to_num(record.force)
        for dof, cell in self.cells.items():
            shown[:, dof] = cell.shown
        self.shown, self.inside = shown, interpolated_force(replace(record, force=shown), substeps)
        self.place = np.linspace(0.0, record.step, len(self.inside))[:, None]

    def at_samples(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray:
        """(N, n), N; 0 where unknown."""
        force = self.shown.copy()
        for dof, cell in self.cells.items():
            gain, nothing = cell.numbers(parameters)
            force[:, dof] = (force[:, dof] - nothing) / gain
        return force

    def between(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray:
        """(2 substeps + 1, N - 1, n), N."""
        if not self.cells:
            return self.inside
        force = self.inside.copy()
        for dof, cell in self.cells.items():
            gain, nothing = cell.numbers(parameters)
            drift = float(parameters["drift"][cell.gauge])
            force[:, :, dof] = (force[:, :, dof] - nothing[:-1] - drift * self.place) / gain
        return force

    def precision(self, parameter: Parameter, corner: float) -> float:
        """Prior precision of a parameter, see :attr:`pinn_cli.baseline.state_space.StateSpace.precision`.

        Args:
            parameter: Any.
            corner: Angular frequency at which the record's band ends, 1/s.
        """
        cell = next((cell for cell in self.cells.values() if cell.gauge == parameter.index), None)
        if cell is None or not parameter.unknown or parameter.kind not in ("offset", "drift"):
            return 1.0
        duration = float(cell.since[-1] - cell.since[0])
        of_mean = float(np.std(cell.shown)) / np.sqrt(corner * duration / np.pi)
        # A straight line through scatter has four times the variance of its mean at its ends, and so much slope.
        std = 2.0 * of_mean if parameter.kind == "offset" else np.sqrt(12.0) * of_mean / duration
        return float(max(parameter.prior_std / max(std, 1e-300), 1.0)) ** 2

    def by_numbers(self, parameters: Mapping[str, np.ndarray], uncertain: tuple[Parameter, ...]) -> np.ndarray:
        """(N, n, p), change of the forces with the load cells' uncertain numbers, in prior standard deviations."""
        force = self.at_samples(parameters)
        out = np.zeros((*force.shape, len(uncertain)))
        for dof, cell in self.cells.items():
            gain, _ = cell.numbers(parameters)
            out[:, dof] = -cell.by_numbers(force[:, dof], uncertain) / gain
        return out


def _of_gauge(number: int, gauge: Gauge, record: Record) -> Channel:
    place, off = _places(gauge, record)
    shown, there = np.zeros(len(record.time)), np.zeros(len(record.time), dtype=bool)
    late = gauge.of("delay").value
    since = record.time + late - gauge.start
    if off > ON_TIME:  # it misses no sample, and a spline through them tells what it shows between
        shown[:] = gauge.history(record.time, {"gain": 1.0, "offset": 0.0, "drift": 0.0})
        there[:] = (record.time + late >= gauge.time[0]) & (record.time + late <= gauge.time[-1])
    else:
        inside = (place >= 0) & (place < len(record.time))
        shown[place[inside]], there[place[inside]] = gauge.values[inside], True
    return Channel(gauge.quantity, gauge.weights, np.where(there, shown, 0.0), there, since, number)


def _places(gauge: Gauge, record: Record) -> tuple[np.ndarray, float]:
    """The record's sample that every sample of a gauge is (J,), and how far they are off, in steps, at most."""
    position = (gauge.time - gauge.of("delay").value - record.time[0]) / record.step
    place = np.rint(position).astype(np.int64)
    return place, float(np.abs(position - place).max())


def check_gauges(record: Record, name: str) -> None:
    """Refuse sensors that the smoother has no rows for.

    Args:
        record: What was measured.
        name: Of the smoother.

    Raises:
        InputError: A delay in doubt, the force of a connection, samples between the record's times, a load cell with
            gaps or beside another one.
    """
    for gauge in record.gauges:
        reason = _unfit(gauge, record)
        if reason:
            allowed, why = reason
            raise InputError("baseline", name, f"none where {allowed}", f"channel {gauge.name} {why}")


def _unfit(gauge: Gauge, record: Record) -> tuple[str, str] | None:
    if not gauge.of("delay").is_known:
        return "a delay is in doubt", "is such: the smoother knows the motion at samples only"
    if gauge.filter_order or TILT in gauge.calibration:
        return "a sensor tilts or is behind a filter", "does: the smoother has no state of it"
    if gauge.quantity not in (*RESPONSE_QUANTITIES, FORCE):
        return "a sensor feels no motion of DOFs and no force on one", f"measures {gauge.quantity}"
    whole = gauge.even_step is not None and gauge.even_step < (1.0 + ON_TIME) * record.step
    if not whole and _places(gauge, record)[1] > ON_TIME:
        return "samples lie between the record's times", "is such"
    if gauge.quantity == FORCE and not (whole and gauge.dof is not None):
        return "a load cell misses samples", "is such" if not whole else "stands beside another one"
    return None


def uncertain_numbers(uncertain: tuple[Parameter, ...]) -> np.ndarray:
    """(p,) bool: the uncertain parameters that are sensors'."""
    return np.array([p.kind in CALIBRATION_UNITS for p in uncertain], dtype=bool)


def load_cell_noise(record: Record, response: Mapping[str, np.ndarray], force: np.ndarray) -> np.ndarray:
    """(n,), N, noise of all load cells; of one that is a gauge in what it feels, its gain taken as it is believed."""
    out = np.array(force, dtype=np.float64)
    for number, gauge in enumerate(record.gauges):
        if gauge.quantity == FORCE and gauge.dof is not None:
            out[gauge.dof] = response[GAUGE][number] / abs(gauge.of("gain").value)
    return out
