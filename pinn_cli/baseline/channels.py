"""The smoother's sensors at the record's times: what they show, where samples are missing, and their rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from torch import Tensor

from pinn_cli.baseline.equations import Equations
from pinn_cli.record.channel import Channel
from pinn_cli.record.record import Record
from pinn_cli.settings.errors import InputError
from pinn_cli.system.dynamics import Dynamics
from pinn_cli.system.functions import Jet
from pinn_cli.training.factors.feels import Feels
from pinn_cli.training.sensor_samples import SensorSamples

# Part of a step by which a sample may be off the record's times.
ON_TIME = 0.01


@dataclass(frozen=True, eq=False)
class ChannelRows:
    """One channel: gain times what it feels, an offset and a drift.

    Attributes:
        channel: Which.
        samples: Its noise by itself.
        feels: What it feels of the functions of time.
        shown: (N,), what it shows; 0 where it has no sample.
        present: (N,) bool, where it has one.
        since: (N,), time from which its drift counts, s.
    """

    channel: Channel
    samples: SensorSamples
    feels: Feels
    shown: np.ndarray
    present: np.ndarray
    since: np.ndarray

    @classmethod
    def of(cls, samples: SensorSamples, feels: Feels, time: np.ndarray) -> ChannelRows:
        """Of a channel that :func:`check_channels` passes, at the record's times (N,), s."""
        channel = samples.channel
        place, off = channel.places(time)
        shown, present = np.zeros(len(time)), np.zeros(len(time), dtype=bool)
        late = channel.number("delay").value
        if np.abs(off).max() > ON_TIME:  # it misses no sample, and a spline through them tells what it shows between
            shown[:] = channel.history(time, {"gain": 1.0, "offset": 0.0, "drift": 0.0})
            present[:] = (time + late >= channel.time[0]) & (time + late <= channel.time[-1])
        else:
            inside = (place >= 0) & (place < len(time))
            shown[place[inside]], present[place[inside]] = channel.measured[inside], True
        return cls(channel, samples, feels, np.where(present, shown, 0.0), present, time + late - channel.start)

    def gain(self, parameters: Mapping[str, Tensor]) -> float:
        """Of what it shows over what it feels."""
        return float(parameters["gain"][self.channel.index])

    def residual(self, jet: Jet, parameters: Mapping[str, Tensor]) -> np.ndarray:
        """(N,), what it shows minus what it would show of functions (N, F); 0 where it has no sample."""
        offset, drift = (float(parameters[kind][self.channel.index]) for kind in ("offset", "drift"))
        measurand = self.feels.value(jet, parameters).numpy()
        residual: np.ndarray = self.shown - (self.gain(parameters) * measurand + offset + drift * self.since)
        return residual * self.present

    def rows(self, jet: Jet, by: np.ndarray, equations: Equations) -> np.ndarray:
        """(N, columns), derivatives of what it shows. A row of zeros, of a sample that is not there, tells nothing.

        Args:
            jet: Functions (N, F).
            by: Of these, see :meth:`Equations.derivatives`.
            equations: Theirs.
        """
        parameters, vector = equations.parameters, equations.vector
        gain, out = self.gain(parameters), np.zeros(by.shape[1:2] + by.shape[3:])
        parts, of_model = self.feels.linearised(jet, parameters)
        for function, order, weight in parts:
            out += gain * np.atleast_1d(weight)[:, None] * by[order][:, function]
        measurand = self.feels.value(jet, parameters).numpy()
        by_kind = {"gain": measurand, "offset": np.ones_like(measurand), "drift": self.since}
        places = zip(vector.moving, vector.column.tolist(), strict=True)
        for column, (p, place) in enumerate(places, len(out[0]) - len(vector.moving)):
            if place in of_model:
                out[:, column] += gain * p.prior_std * of_model[place].numpy()
            if p.kind in by_kind and p.index == self.channel.index:
                out[:, column] += p.prior_std * by_kind[p.kind]
        return out * self.present[:, None]


def channels_of(record: Record, dynamics: Dynamics) -> list[Channel]:
    """Its calibrated channels, and behind them its other columns as if they were such, with nothing in doubt."""
    plain = [record.column(q, i) for q in dynamics.observed for i in np.flatnonzero(record.plain(q)).tolist()]
    return [replace(channel, index=index) for index, channel in enumerate((*record.calibrated, *plain))]


def check_channels(record: Record, name: str) -> None:
    """Refuse sensors that the smoother has no rows for.

    Args:
        record: What was measured.
        name: Of the smoother.

    Raises:
        InputError: A delay in doubt, a filter, samples between the record's times.
    """
    for channel in record.calibrated:
        reason = _unfit(channel, record)
        if reason:
            allowed, why = reason
            raise InputError("baseline", name, f"none where {allowed}", f"channel {channel.key} {why}")


def _unfit(channel: Channel, record: Record) -> tuple[str, str] | None:
    if not channel.number("delay").is_known:
        return "a delay is in doubt", "is such: the smoother knows the motion at samples only"
    if channel.filter_order:
        return "a sensor is behind a filter", "is such: the smoother has no state of it"
    whole = channel.even_step is not None and channel.even_step < (1.0 + ON_TIME) * record.step
    if not whole and np.abs(channel.places(record.time)[1]).max() > ON_TIME:
        return "samples lie between the record's times", "is such"
    return None
