"""The free run: what the estimated system does when it is left to itself, and how far that is what was estimated.

A training ties parameters and response together only through a loss, so a small loss can go with wrong parameters.
Simulating the estimated system from the estimated initial state under the measured force leaves no such room: the
parameters alone shape the response, and their error adds up over the record.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from pinn_cli.record.free_run import NoFreeRunError, free_run_of
from pinn_cli.record.record import Record
from pinn_cli.record.response import RESPONSE_QUANTITIES, Response
from pinn_cli.report.fitness import fitness_percent, fitness_table
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import Estimate
from pinn_cli.training.estimated_structure import estimated_structure

REFERENCES = ("truth", "sensors", "estimate")

# Agreement of displacements, by the printed formula, below which a free run contradicts the estimate. 6-DOF Duffing
# chain, one load cell: right parameters give 99.9, 99 and 96 to 98 % at 50, 20 and 10 dB; a linear model 91 % (62 with
# its parameters held fixed), parameters held 5 to 10 % off 84 %.
CONTRADICTED_BELOW = 95.0

# One over the share of the record at its start that is left out where the start is not to count: there the ends of
# splines show, and the motion far from the sensors is poorly known for as long as a wave takes to get there.
EXCUSED_SHARE = 10


@dataclass(frozen=True, eq=False)
class FreeRun:
    """What came of a free run.

    Attributes:
        response: Of the estimated system, (N, n) each, with the measured force; None where there is none.
        finding: Why there is none, or what is wrong with it, in plain words; "" where nothing is.
        agreement: With the estimated displacements where neither noise nor the start explains how far it is off, %;
            NaN where it is not, or noise or the start does.
    """

    response: Response | None
    finding: str = ""
    agreement: float = math.nan


def free_run(prescribed: Structure, estimate: Estimate, record: Record) -> FreeRun:
    """Simulate the estimated system from the estimated initial state under the measured force.

    No free run is an error: a force that is neither measured nor known to be zero, and a system too stiff or unstable,
    are findings.

    Args:
        prescribed: The chain that the estimator was given.
        estimate: Whose parameters and whose state at the first sample are taken.
        record: Whose force acts, and the motion of whose ground and supports; what these do between the samples is its
            ``intersample``.
    """
    structure = estimated_structure(prescribed, estimate.parameters)
    try:
        response = free_run_of(structure, record, estimate.response, 0)
    except NoFreeRunError as error:
        return FreeRun(None, str(error))
    agreement = _agreement(response, estimate)
    if not agreement < CONTRADICTED_BELOW:
        return FreeRun(response)
    extent = f"to {agreement:.1f} % only" if agreement > 0.0 else "not at all"
    first = len(record.time) // EXCUSED_SHARE
    excused = _excused_agreement(structure, estimate, record, first)
    if excused >= CONTRADICTED_BELOW:
        later = f"under the estimated force and from {record.time[first]:.4g} s on, to {excused:.1f} %"
        why = "the noise of the measured force or the estimated start explains it"
        return FreeRun(response, f"the free run's displacements agree with the estimate {extent}; {later}: {why}")
    found = f"in a free run their displacements agree with it {extent}"
    why = "the model, the parameters or the response is wrong"
    warning = f"warning: the estimated parameters do not reproduce the estimated response: {found}; {why}"
    return FreeRun(response, warning, agreement)


def free_run_table(run: FreeRun, estimate: Estimate, record: Record, truth: Response) -> pd.DataFrame:
    """Both fitness formulas of the free run's motion (the content of ``free_run.csv``); the force is given.

    Its columns are those of `pinn_cli.report.fitness.fitness_table` and, before them, ``against``: `REFERENCES`. Cells
    are empty where the run has no response, or its reference is unknown. The sensors are noisy; averages over groups
    go over the DOFs that have one.
    """
    response = run.response or Response.unknown(record.time, record.ndof)
    sensors = Response(record.time, record.displacement, record.velocity, record.acceleration, record.force)
    tables = []
    for name, reference in zip(REFERENCES, (truth, sensors, estimate.response), strict=True):
        table = fitness_table(response, reference, record.observed)
        table.insert(0, "against", name)
        tables.append(table[table["quantity"].isin(RESPONSE_QUANTITIES)])
    return pd.concat(tables, ignore_index=True)


def _excused_agreement(structure: Structure, estimate: Estimate, record: Record, first: int) -> float:
    """Agreement where only the model and its parameters can be to blame, %; NaN where the run overflows.

    Two things move a right system away from its estimate as well: the noise of the measured force and of the ground's
    acceleration, of which the estimated ones are free, and the start, which nothing before it pins down. Where every
    DOF carries a force that is estimated from the motion alone, this excuses wrong parameters too: the estimated force
    makes up for them.
    """
    found = estimate.response
    force = np.where(record.sensors("force"), found.force, record.force)
    ground = record.ground_acceleration if found.ground_acceleration is None else found.ground_acceleration
    try:
        acting = replace(record, force=force, ground_acceleration=ground)
        if found.supports is not None:
            acting = acting.carried_by(found.supports, first)
        return _agreement(free_run_of(structure, acting, found, first, first), estimate)
    except NoFreeRunError:
        return math.nan


def _agreement(response: Response, estimate: Estimate) -> float:
    """Printed fitness of the displacements against the last estimated ones, mean over DOFs, %; NaN if none moves."""
    scores = fitness_percent(response.displacement, estimate.response.displacement[-len(response.time) :])
    return float(np.mean(scores[np.isfinite(scores)])) if np.isfinite(scores).any() else math.nan
