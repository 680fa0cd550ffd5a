"""The evidence of the training as a score: how probable the record is under a model, everything integrated out."""

from __future__ import annotations

import pandas as pd

from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.settings.errors import InputError
from pinn_cli.training.estimate import Estimate
from pinn_cli.validation.validation import Score, Setup, Validation


class EvidenceScore(Validation):
    """Minus the logarithm of the marginal likelihood (:mod:`pinn_cli.training.evidence`), in nats.

    It is known up to a constant of the network and of the sensors' noise, so it compares what is prescribed of the
    chain under one network, and no two networks: those are told apart by :mod:`pinn_cli.validation.heldout`.
    """

    name = "evidence"
    scores_records = True

    def check(self, problem: JointProblem, setup: Setup) -> None:
        """See :meth:`Validation.check`."""
        if not setup.estimator.gives_evidence:
            allowed = "used with training=gauss_newton (weights inferred) and network=spline or fourier"
            raise InputError("validation", self.name, allowed, "validation=heldout scores any training")

    def score(self, problem: JointProblem, estimate: Estimate, setup: Setup) -> Score:
        """See :meth:`Validation.score`."""
        value = -float(estimate.summary["log_evidence"])
        return Score(value, pd.DataFrame([{"validation": self.name, "score": value}]))
