"""What an estimator is given: a prescribed chain, a record, and which parameters may move. Never the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pinn_cli.record.record import Record
from pinn_cli.system.chain import Chain


@dataclass(frozen=True, eq=False)
class UncertainParameter:
    """A parameter of one connection that is learned along with the states, under a Gaussian prior.

    Attributes:
        kind: ``m``, ``c``, ``k``, ``kappa``, ...
        dof: Its connection, counted from 0.
        prescribed: Prior mean, the value that the user believes in.
        prior_std: Prior standard deviation, in the parameter's unit.
    """

    kind: str
    dof: int
    prescribed: float
    prior_std: float

    @property
    def name(self) -> str:
        """Kind and connection, counted from 1, as tables print it: ``k_2``."""
        return f"{self.kind}_{self.dof + 1}"


@dataclass(frozen=True, eq=False)
class Problem:
    """One estimation problem.

    Attributes:
        chain: The prescribed model.
        record: What was measured, with the sensors that the scheme allows.
        uncertain: The parameters that may move; all others are held at their prescribed values.
        acceleration_through: Whether measured accelerations are compared with the network's second derivative
            (``derivative``), with the observer equation (paper, eq. 8; ``observer``), or with ``both``.
    """

    chain: Chain
    record: Record
    uncertain: tuple[UncertainParameter, ...] = ()
    acceleration_through: str = "derivative"

    def without_uncertainty(self) -> Problem:
        """The same problem with every parameter held fixed."""
        return replace(self, uncertain=())
