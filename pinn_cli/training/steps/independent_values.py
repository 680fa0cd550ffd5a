"""The discrepancy as the few independent values that it has."""

from __future__ import annotations

from dataclasses import replace

from pinn_cli.training.evidence import Evidence, Trained
from pinn_cli.training.record_evidence import occupied_share
from pinn_cli.training.solver import Inference


def count_independent_values(found: Inference) -> Inference:
    """The solution with the discrepancy that its own colour asks for."""
    return replace(found, trained=widened(found.evidence, found.trained))


def widened(evidence: Evidence, trained: Trained) -> Trained:
    """Solved once more with a wider discrepancy; the same where that cannot be solved.

    The search takes the discrepancy for K independent values per DOF. A model error that fills only part of the
    features' band has fewer, N_eff, and larger ones; counting K of them makes states look better known than they
    are. N_eff / K is the bandwidth of the physics residual, (sum S)^2 / (M sum S^2), over the M frequencies that
    the features follow.
    """
    levels = zip(trained.noise.records, evidence.each_record(occupied_share, trained), strict=True)
    noise = replace(trained.noise, records=tuple(level.widened(share) for level, share in levels))
    wider = evidence.train(noise, trained.solution.point)
    return wider if wider is not None and wider.solution.converged else trained
