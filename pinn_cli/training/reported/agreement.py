"""Whether records that were solved together say the same of their parameters."""

from __future__ import annotations

import numpy as np

from pinn_cli.training.estimate import Disagreement
from pinn_cli.training.evidence import Evidence, Trained
from pinn_cli.training.record_evidence import RecordEvidence, RecordSolution

# Directions of the parameters that a record tells and the others do not, over its own information: nothing compares
# them.
COMPARED = 1e-6


def disagreements(evidence: Evidence, trained: Trained) -> tuple[Disagreement, ...]:
    """How far every record pulls the parameters from where all of them ended, against chance.

    The pull is what its own misfit falls with the parameters, its motion following them. With the record's information
    S and the covariance C of all records together it has the covariance S - S C S if all measured one structure.
    """
    equations, out = evidence.equations, []
    covariance = trained.factor.corner_covariance
    at, scale = trained.solution.point.parameters.cpu().numpy(), equations.scale
    precision = equations.precision(trained.noise).numpy()
    start = np.array([p.prescribed for p in equations.uncertain])
    for columns, (whole, every) in zip(equations.columns, evidence.each_record(own_information, trained), strict=True):
        # A bound holds others back, and says nothing about chance.
        free = at[columns] > equations.lower[columns]
        own, information, pull = columns[free], whole[np.ix_(free, free)], every[free]
        square, freedom = _against_chance(information, pull, covariance[np.ix_(own, own)])
        alone = at[own] + np.linalg.solve(information + np.diag(precision[own]), pull)
        values = {equations.uncertain[i].name: float(start[i] + scale[i] * x) for i, x in zip(own, alone, strict=True)}
        out.append(Disagreement(square, freedom, values))
    return tuple(out)


def own_information(evidence: RecordEvidence, solution: RecordSolution) -> tuple[np.ndarray, np.ndarray]:
    """Of one record: its own information about its parameters (p, p), and its pull on them (p,)."""
    system = evidence.equations.assemble(solution.point, solution.noise)
    eliminated = system.eliminated()
    if eliminated is None:
        p = len(solution.point.parameters)
        return np.zeros((p, p)), np.zeros(p)
    return eliminated.complement, eliminated.reduced(system)[1]


def _against_chance(information: np.ndarray, pull: np.ndarray, covariance: np.ndarray) -> tuple[float, int]:
    """Sum of squares of the pull over its variance, and over how many directions."""
    unit = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    scatter = (information - information @ covariance @ information) / np.outer(unit, unit)
    values, vectors = np.linalg.eigh((scatter + scatter.T) / 2.0)
    kept = values > COMPARED
    along = vectors.T[kept] @ (pull / unit)
    return float(np.sum(along**2 / values[kept])), int(kept.sum())
