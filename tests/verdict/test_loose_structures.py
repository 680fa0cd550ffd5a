"""A structure that nothing holds is allowed: it is told, and no fault."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from small_estimates import make_estimate
from small_problems import measured

from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.system.modes import modes_of
from pinn_cli.system.topology import build_structure
from pinn_cli.verdict.parameter_findings import parameter_findings
from pinn_cli.verdict.prediction import predicted

SPRING = {"between": ["a", "b"], "law": "linear", "c": 1.0, "k": 15.0}
FREE = build_structure(["a", "b"], 10.0, {"spring": SPRING})
HELD = build_structure(["a", "b"], 10.0, {"spring": SPRING, "foot": {**SPRING, "between": ["ground", "a"]}})


def findings(structure):
    measurements = measured(structure, duration=20.0, samples=401)
    scheme = SparseRecovery(unobserved=[])
    record = replace(scheme.observe(measurements.record), dofs=("a", "b"))
    problem = scheme.pose(structure, [record]).alone
    estimate = make_estimate().estimate
    return [(f.kind, f.word, f.text) for f in parameter_findings(problem, replace(estimate, parameters=()), structure)]


def test_a_free_body_is_told_by_its_names_and_is_no_fault():
    ((kind, word, text),) = findings(FREE)
    assert (kind, word) == ("held", "sound")
    assert text.startswith("the structure is not held: DOFs a, b can move as a rigid body")


def test_a_structure_that_is_held_is_not_told():
    assert findings(HELD) == []


def test_a_free_body_has_a_prediction():
    measurements = measured(FREE, duration=20.0, samples=401)
    prediction = predicted(FREE, measurements.record)
    truth = measurements.truth.response
    np.testing.assert_allclose(
        prediction.response.displacement, truth.displacement, atol=1e-3 * np.ptp(truth.displacement)
    )
    assert modes_of(FREE).natural_frequencies[0] == 0.0
