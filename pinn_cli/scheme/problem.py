"""What an estimator is given: a prescribed chain, a record, and which parameters may move. Never the truth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pinn_cli.record.record import Record
from pinn_cli.scheme.initial_motion import FREE, initial_deviation
from pinn_cli.system.chain import Chain

if TYPE_CHECKING:
    from pinn_cli.scheme.priors import Prior

# What measured accelerations can be compared with.
THROUGH = ("derivative", "observer", "both")


@dataclass(frozen=True, eq=False)
class UncertainParameter:
    """A parameter of one connection that is estimated along with the states, under a Gaussian prior.

    Attributes:
        kind: ``m``, ``c``, ``k``, ``kappa``, ...
        dof: Its connection, counted from 0.
        prescribed: Prior mean: the value that the user believes in, or where an unknown one starts.
        prior_std: Prior standard deviation, in the parameter's unit.
        scale: Its order of magnitude, the step of gradient methods; None: its value, or its prior standard deviation
            where that is larger.
        unknown: Whether it is to be identified from the record; otherwise it is believed, and its prior may be
            sharpened or widened together with that of all others that are believed.
        positive: Whether it cannot be below zero.
    """

    kind: str
    dof: int
    prescribed: float
    prior_std: float
    scale: float | None = None
    unknown: bool = False
    positive: bool = False

    @property
    def name(self) -> str:
        """Kind and connection, counted from 1, as tables print it: ``k_2``."""
        return f"{self.kind}_{self.dof + 1}"

    @property
    def unit(self) -> float:
        """What a gradient method's steps of the parameter are counted in."""
        return max(abs(self.prescribed), self.prior_std) if self.scale is None else self.scale

    @property
    def lower(self) -> float:
        """Most negative distance from the prescribed value, in the parameter's unit."""
        return -self.prescribed if self.positive else -math.inf

    def value(self, distance: float) -> float:
        """The parameter at a distance from its prescribed value; never below its bound, whatever the rounding."""
        return float(max(self.prescribed + distance, 0.0 if self.positive else -math.inf))


@dataclass(frozen=True, eq=False)
class Problem:
    """One estimation problem.

    Attributes:
        chain: The prescribed model; of an unknown parameter it has the value at which it starts.
        record: What was measured, with the sensors that the scheme allows.
        uncertain: The parameters that may move; all others are held at their prescribed values.
        acceleration_through: Whether measured accelerations are compared with the network's second derivative
            (``derivative``), with the observer equation (paper, eq. 8; ``observer``), or with ``both``.
        priors: (kind, connection from 0) of every uncertain parameter to its prior, where their posterior distribution
            is wanted; None where estimates with standard deviations will do.
        initial_motion: Whether the motion begins anyhow (``free``) or at ``rest`` at the record's first sample.
        alternatives: The same from other starts of the unknown parameters, for a training that can compare solutions.
    """

    chain: Chain
    record: Record
    uncertain: tuple[UncertainParameter, ...] = ()
    acceleration_through: str = "derivative"
    priors: Mapping[tuple[str, int], Prior] | None = None
    initial_motion: str = FREE
    alternatives: tuple[Problem, ...] = ()

    @property
    def initial_deviation(self) -> tuple[float, float] | None:
        """See :func:`pinn_cli.scheme.initial_motion.initial_deviation`."""
        return initial_deviation(self.record, self.initial_motion)

    @property
    def identifies(self) -> bool:
        """Whether any parameter is unknown."""
        return any(parameter.unknown for parameter in self.uncertain)
