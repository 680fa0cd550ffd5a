"""Estimates of records that other code has made, by the spline and its own training."""

from independent_records import IndependentRecord

from pinn_cli.network.spline import Spline
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.training.gauss_newton import GaussNewton


def model(made: IndependentRecord) -> Structure:
    """The right chain of a record."""
    s = made.structure
    return build_chain(len(s.m), Duffing(), m=s.m.tolist(), c=s.c.tolist(), k=s.k.tolist(), kappa=s.kappa.tolist())


def by_spline(problem: Problem | JointProblem, **settings) -> Estimate:
    """Of one record or of several; ``settings`` of the training."""
    joint = problem if isinstance(problem, JointProblem) else JointProblem.of(problem)
    return GaussNewton(**settings).solve(joint, Spline(), RunContext())


def estimated(made: IndependentRecord, **settings) -> Estimate:
    """With its parameters known; ``settings`` of the training."""
    return by_spline(Problem(model(made), made.record), **settings)
