"""A kind of sensor of one's own: what it feels of the motion, in a unit of its own."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

from omegaconf import OmegaConf

from pinn_cli.record.units import factor
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.instantiation import build

# Keys of a channel that say what it feels, which its own kind says.
SAID_BY_ITS_KIND = ("dof", "between", "weights", "connection", "support")


class OwnSensor(ABC):
    """A sensor that shows a weighted sum of motions; ``data.channels.NAME.sensor`` names its class and its settings.

    Attributes:
        quantity: Of the motions: ``displacement``, ``velocity`` or ``acceleration``.
        unit: Of what it shows, by pint's name; the channel's ``unit`` is converted to it.
    """

    quantity: ClassVar[str]
    unit: ClassVar[str]

    @abstractmethod
    def weights(self) -> Mapping[int | str, float]:
        """DOF, its number from 1 or its name, to how much the sensor shows for one m (m/s, m/s^2) of its motion."""


def as_channel(setting: str, channel: Mapping[str, Any]) -> Mapping[str, Any]:
    """A channel whose sensor is a class of somebody's own as one that feels a weighted sum; others as they are.

    A class that is not registered is refused, settings that it refuses, and a channel that says what it feels as well.
    """
    given = channel.get("sensor")
    if not isinstance(given, Mapping):
        return channel
    sensor = build(OmegaConf.create(dict(given)), f"{setting}.sensor")
    if not isinstance(sensor, OwnSensor):
        raise InputError(f"{setting}.sensor", given.get("_target_"), "a class of OwnSensor")
    for key in SAID_BY_ITS_KIND:
        if channel.get(key) is not None:
            raise InputError(f"{setting}.{key}", channel[key], "left out: the sensor's own settings say what it feels")
    unit = factor(f"{setting}.unit", channel.get("unit"), sensor.unit, type(sensor).__name__)
    return {**channel, "sensor": sensor.quantity, "weights": dict(sensor.weights()), "unit": unit}
