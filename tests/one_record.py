"""One record alone as the solvers of several take it, a list of one; and estimates of records by the spline."""

from typing import Any

import numpy as np
import torch
from independent_records import IndependentRecord

from pinn_cli.network.spline import Spline
from pinn_cli.record.record import Record
from pinn_cli.runs.side_by_side import Items
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import Estimate, RunContext
from pinn_cli.training.evidence import Evidence, Trained
from pinn_cli.training.factors.constant_channels import ConstantChannels
from pinn_cli.training.factors.factor import Residuals
from pinn_cli.training.gauss_newton import GaussNewton
from pinn_cli.training.least_squares import LeastSquares
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseLevels, NoiseModel
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.normal_matrix.bordered import BorderedFactor, BorderedSystem, SharedSystem
from pinn_cli.training.normal_matrix.elimination import Diagonals
from pinn_cli.training.record_evidence import RecordEvidence
from pinn_cli.training.sensor_samples import starting_levels


def evidence_of(equations: NormalEquations, iterations: int = 12, tolerance: float = 1e-6, **settings) -> Evidence:
    return Evidence([equations], iterations, tolerance, lambda losses, noise: None, **settings)


def problem_of(equations: NormalEquations) -> LeastSquares:
    return LeastSquares([RecordEvidence(equations)])


def levels_of(noise: NoiseModel, spread: float = 1.0) -> NoiseLevels:
    return NoiseLevels((noise,), spread)


def shown_noise(record: Record, discrepancy: float, continuity: float = 1.0) -> NoiseModel:
    """Sensors' noise as their spectra show it."""
    response = {quantity: starting_levels(record, quantity) for quantity in record.response_quantities}
    return NoiseModel(response, starting_levels(record, "force"), discrepancy, continuity)


def residuals_of(equations: NormalEquations, point: Point) -> dict[str, torch.Tensor]:
    """Of the sensors on the record's clock and of the equations, whole, by name."""
    each = [factor for factor in equations.factors if isinstance(factor, ConstantChannels | Residuals)]
    return {factor.name: torch.cat([found[-1] for found in factor.residuals(point)]) for factor in each}


def weights_of(equations: NormalEquations, noise: NoiseModel) -> dict[str, torch.Tensor]:
    """Of the same."""
    each = [factor for factor in equations.factors if isinstance(factor, ConstantChannels | Residuals)]
    return {factor.name: factor.weight(noise) for factor in each}


def diagonals(matrix: np.ndarray, offsets: np.ndarray) -> Diagonals:
    """Some diagonals of the lower half of a symmetric matrix."""
    return Diagonals(offsets, np.array([np.pad(np.diag(matrix, -k), (0, k)) for k in offsets]))


def shared(system: BorderedSystem, held: np.ndarray | None = None) -> SharedSystem:
    p = len(system.corner)
    return SharedSystem(Items([None]), [np.arange(p)], [system], np.zeros(p), np.zeros(p), held)


def factored(system: BorderedSystem, damping: float = 0.0, held: np.ndarray | None = None) -> BorderedFactor:
    """Of all its unknowns."""
    return BorderedFactor(shared(system, held).factor(damping).schur, system.eliminated(damping).readout)


def of_record(function, evidence: Evidence, trained: Trained, *arguments: Any) -> Any:
    """What a function makes of the one record's own part of a solution."""
    return evidence.each_record(function, trained, *([own] for own in arguments))[0]


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
