"""What an estimator is, and what a training is: an estimator once it has a network."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from pinn_cli.network.network import Network, NetworkDesign
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.settings.errors import InputError
from pinn_cli.training.estimate import Estimate, RunContext


class Estimator(ABC):
    """From a problem to an estimate: a network that is trained, a Kalman smoother.

    A new one to compare with the network is a file in ``pinn_cli/baseline`` and a file in ``conf/baseline``.

    Attributes:
        name: What the tables call it in their column ``estimator``.
    """

    name: ClassVar[str]

    def check(self, problem: Problem) -> None:  # noqa: B027 - most can solve any
        """Refuse a problem of one record that it cannot solve, before any work is done.

        Raises:
            InputError: It cannot.
        """

    @abstractmethod
    def solve(self, problem: JointProblem, run: RunContext) -> Estimate:
        """Motion, forces and parameters, with their uncertainty, from the records of a problem.

        Raises:
            InputError: The problem cannot be solved this way.
            DivergenceError: The numbers left the finite ones.
        """

    @property
    def gives_evidence(self) -> bool:
        """Whether it says how probable the record is under its model, as ``log_evidence`` of its summary."""
        return False

    @property
    def solves_records(self) -> bool:
        """Whether it solves several records together."""
        return False


def built(design: NetworkDesign, problem: Problem) -> Network:
    """A network with an output for every unknown function of a problem; one of one's own may know of motions alone."""
    if problem.dynamics.is_plain:
        return design.build(problem.record)
    return design.build(problem.record, functions=problem.dynamics.size)


class Training(ABC):
    """A way of making the residuals of a problem small. A new one is a file here and a file in ``conf/training``."""

    @abstractmethod
    def solve(self, problem: JointProblem, design: NetworkDesign, run: RunContext) -> Estimate:
        """Train a network of the given design on the problem.

        Raises:
            InputError: The network cannot be trained this way.
            DivergenceError: The loss left the finite numbers.
        """

    def solves_inputs(self, design: NetworkDesign) -> bool:
        """Whether it finds hidden forces, unmeasured forces and the ground's acceleration beside the motion."""
        return False

    def gives_evidence(self, design: NetworkDesign) -> bool:
        """See :attr:`Estimator.gives_evidence`, with a network of the given design."""
        return False

    def solves_records(self, design: NetworkDesign) -> bool:
        """See :attr:`Estimator.solves_records`, with a network of the given design."""
        return False


@dataclass(frozen=True)
class TrainedNetwork(Estimator):
    """A physics-informed neural network.

    Attributes:
        training: How it is trained.
        design: Of the network.
    """

    training: Training
    design: NetworkDesign
    name = "pinn"

    def check(self, problem: Problem) -> None:
        """See :meth:`Estimator.check`."""
        if not problem.dynamics.is_plain and not self.training.solves_inputs(self.design):
            allowed = f"network=spline with training=gauss_newton where {problem.dynamics.also_unknown} is to be found"
            hint = "scheme.unknown_force=free leaves an unmeasured force to the motion" if problem.inputs.forces else ""
            raise InputError("network", self.design.name, allowed, hint)
        if problem.structure.is_damped_as_whole and not self.training.solves_inputs(self.design):
            hint = (
                "the modes that system.damping speaks of move with the parameters; other trainings do not follow them"
            )
            raise InputError(
                "network", self.design.name, "spline with training=gauss_newton where system.damping is given", hint
            )
        if problem.record.calibrated and not self.training.solves_inputs(self.design):
            allowed = "network=spline with training=gauss_newton where samples are missing or a sensor is in doubt"
            raise InputError(
                "network", self.design.name, allowed, f"channel {problem.record.calibrated[0].key} is such"
            )
        if problem.prior is not None and not self.training.solves_inputs(self.design):
            allowed = "spline, with training=gauss_newton and inferred weights, where model=... says what is known"
            raise InputError("network", self.design.name, allowed, "other trainings know no correlated parameters")
        if not problem.dynamics.is_plain and problem.acceleration_through != "derivative":
            hint = f"with {problem.dynamics.also_unknown} the observer equation has no one force"
            raise InputError("scheme.acceleration_through", problem.acceleration_through, "derivative", hint)

    def solve(self, problem: JointProblem, run: RunContext) -> Estimate:
        """See :meth:`Estimator.solve`."""
        return self.training.solve(problem, self.design, run)

    @property
    def gives_evidence(self) -> bool:
        """See :attr:`Estimator.gives_evidence`."""
        return self.training.gives_evidence(self.design)

    @property
    def solves_records(self) -> bool:
        """See :attr:`Estimator.solves_records`."""
        return self.training.solves_records(self.design)
