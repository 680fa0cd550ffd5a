"""The force that the model leaves out over a record: what the motion takes beyond what was measured to act.

A free run under the measured inputs and this force is the estimated motion. It holds the noise of the inputs' sensors
as well. What load cells and the ground's sensor have of it is white, and their spectra show it above the band. If the
record asks for more noise than that, the model is wrong where they act: a mass below a load cell, or all springs of a
structure that the ground moves. With e the force that is missing, d^2 the variance of the discrepancy, and a column of
B for what one standard deviation of every input's noise puts into the equations,

    left out = (1 - B S (d^2 + B' B)^-1 B') e,

with S, diagonal, the share of each input's variance that its spectrum shows.

As much may hide in the parameters, but only at the frequencies of their own forces, those at which the structure moves:
the zeroth and the second harmonic of a forgotten quadratic spring hide in no spring and in no damper.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from pinn_cli.model.knowledge import Misfit
from pinn_cli.record.inputs import input_force
from pinn_cli.record.spectrum import visible_floor
from pinn_cli.system.functions import Jet
from pinn_cli.system.parameters import MASS
from pinn_cli.system.quantities import FORCE, GROUND
from pinn_cli.training.doubts.left_spectra import MOVING
from pinn_cli.training.record_evidence import RecordEvidence, RecordSolution

# Parts of a record whose spectra are averaged.
PARTS = 16


def misfit_history(evidence: RecordEvidence, solution: RecordSolution) -> Misfit:
    """Of one record."""
    equations, noise, record = evidence.equations, solution.noise, evidence.problem.record
    n, point = equations.dynamics.ndof, solution.point
    jet = Jet(*equations.flat_states(equations.forces, point)[:3])
    measured_force = equations.target.force[:: equations.refinement]
    enforced = equations.target.equation[:n]
    lacking = equations.dynamics.residual(jet, equations.parameters(point))[..., :n] - measured_force[..., :n]
    missing = (lacking * enforced).detach().numpy()
    discrepancy = noise.discrepancy / equations.refinement**0.5
    columns, shares = [], []
    for column, sigma, measured, function in _inputs(evidence, solution):
        if function is not None:  # the equations hold the input as it was estimated
            estimated = jet.value[..., function].detach().numpy()
            missing += np.outer(np.nan_to_num(estimated - measured), column)
        floor = visible_floor(measured, record.step) if np.isfinite(measured).all() else None
        columns.append(column * sigma)
        shares.append(1.0 if floor is None else min(1.0, (floor / sigma) ** 2))
    if columns:
        pushed = np.array(columns).T
        inverse = np.linalg.pinv(discrepancy**2 * np.eye(len(columns)) + pushed.T @ pushed, hermitian=True)
        missing -= missing @ pushed @ inverse @ (np.array(shares)[:, None] * pushed.T)
    size = noise.misfit(equations.network.count, len(record.time)) ** 2
    seen = float(np.mean(missing**2))
    rest = discrepancy * math.sqrt(max(0.0, 1.0 - seen / size)) if size > 0.0 else 0.0
    inputs = input_force(equations.dynamics.structure, record)
    velocity = jet.rate[..., :n].detach().numpy()
    return Misfit.of(record.step, missing, float(np.sqrt(np.mean(inputs**2))), rest, _at_motion(missing, velocity))


def _at_motion(missing: np.ndarray, velocity: np.ndarray) -> float:
    """Share, root mean square, of a force (N, n) at the frequencies at which its coordinates move, (N, n)."""
    length = max(2, len(missing) // PARTS)
    parts = (
        sliding_window_view(x, length, axis=0)[:: length // 2] * np.hanning(length + 1)[:-1]
        for x in (missing, velocity)
    )
    force, moved = (np.mean(np.abs(np.fft.rfft(part)) ** 2, axis=0) for part in parts)  # (n, frequencies)
    order = np.argsort(-moved, axis=1)
    force, moved = (np.take_along_axis(power, order, axis=1) for power in (force, moved))
    inside = np.cumsum(moved, axis=1) - moved < MOVING * moved.sum(axis=1, keepdims=True)
    return math.sqrt(float((force * inside).sum() / force.sum())) if force.any() else 0.0


def _inputs(
    evidence: RecordEvidence, solution: RecordSolution
) -> Iterator[tuple[np.ndarray, float, np.ndarray, int | None]]:
    """Of every measured input: what one unit puts into the equations (n,), its noise, its samples, its function."""
    equations, noise, record = evidence.equations, solution.noise, evidence.problem.record
    dynamics = equations.dynamics
    structure, loads = dynamics.structure, dynamics.inputs.loads
    shapes = structure.shapes.matrix
    for dof in np.flatnonzero(record.sensors(FORCE)):
        function = dynamics.loads.start + loads.index(dof) if loads else None
        sigma = (noise.response[FORCE] if loads else noise.force)[dof]
        if np.isfinite(sigma) and sigma > 0.0:
            yield shapes[dof], float(sigma), record.force[:, dof], function
    if dynamics.inputs.ground and record.measured_ground is not None:
        sigma = noise.response[GROUND][0]
        if np.isfinite(sigma) and sigma > 0.0:
            mass = equations.parameters(solution.point)[MASS].detach().numpy()
            yield -mass * structure.with_ground, float(sigma), record.measured_ground, dynamics.ground.start
