"""The force that a model leaves out, as one connection's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_estimates import Case

from pinn_cli.model.misfit import Misfit
from pinn_cli.report.discrepancy import Discrepancy
from pinn_cli.report.results import Results, RunDescription
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Linear
from pinn_cli.training.estimate import ConnectionHistories


def without(case: Case, friction: float, acting: float = 1.0) -> Results:
    """Of a chain of three whose second connection rubs, N; and whose motion is a swept sine."""
    time = case.record.time
    phase = 2.0 * np.pi * (10.0 + 2.0 * time / time[-1]) * time / time[-1]
    e = np.sin(phase)[:, None] * np.array([0.01, 0.02, 0.01])
    force = friction * np.sign(np.gradient(e[:, 1]))
    # What the coordinates feel beside the law and the inputs: B' r with the other sign.
    misfit = Misfit.of(case.record.step, np.column_stack((force, -force, 0.0 * force)), acting, 0.0)
    none = np.zeros_like(e)
    estimate = replace(
        case.estimate, misfit=misfit, connections=ConnectionHistories(e, none, none, none), parameters=[]
    )
    structure = build_chain(3, Linear(), m=1.0, c=1.0, k=15.0)
    run = RunDescription("small", 0, "cpu", 1, "", case.labels, True, "none", "none")
    return Results(run, structure, case.record, case.truth, estimate)


def test_it_is_that_of_the_connection_that_lacks_most_and_follows_its_velocity(make_case):
    found = Discrepancy.of(without(make_case(ndof=3), 0.2))
    assert found is not None
    assert found.connection == "2"
    assert np.median(np.abs(found.force)) == pytest.approx(0.2, rel=0.01)
    assert found.explained_by(found.velocity)[2] > 0.8
    assert found.explained_by(found.elongation)[2] < 0.2
    assert np.corrcoef(found.force, np.sign(found.velocity))[0, 1] == pytest.approx(1.0, abs=0.02)


def test_what_is_not_noticeable_is_not_drawn(make_case):
    assert Discrepancy.of(without(make_case(ndof=3), 0.2, acting=1e3)) is None
