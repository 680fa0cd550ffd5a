"""From a trained linear readout to what is reported: posterior means and standard deviations, and what is left out.

Whether records that were solved together say the same of their parameters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import torch
from numpy.lib.stride_tricks import sliding_window_view
from scipy.sparse import csr_matrix

from pinn_cli.model.knowledge import Misfit, ParameterKnowledge
from pinn_cli.physics import estimated_response
from pinn_cli.record.channel import CALIBRATED
from pinn_cli.record.inputs import input_force
from pinn_cli.record.response import RESPONSE_QUANTITIES, Response
from pinn_cli.record.spectrum import visible_floor
from pinn_cli.system.functions import Jet
from pinn_cli.system.parameters import MASS
from pinn_cli.system.quantities import FORCE, GROUND
from pinn_cli.training.covariance import ReadoutPosterior
from pinn_cli.training.doubts.left_spectra import MOVING
from pinn_cli.training.estimate import ConnectionHistories, Disagreement, Estimate, ParameterEstimate
from pinn_cli.training.evidence import Evidence, Trained, model_log_evidence
from pinn_cli.training.history import History
from pinn_cli.training.levels import values_taken
from pinn_cli.training.noise_model import FoundNoise, NoiseModel
from pinn_cli.training.normal_equations import NormalEquations
from pinn_cli.training.record_evidence import RecordEvidence, RecordSolution
from pinn_cli.training.reported.connection_forces import connection_forces, dissipated_energy
from pinn_cli.training.reported.hand_over import end_state
from pinn_cli.training.reported.parameter_posterior import coherent_misfit, parameter_force, parameter_posterior
from pinn_cli.training.steps.force_spectrum import std_and_misfit

# Directions of the parameters that a record tells and the others do not, over its own information: nothing compares
# them.
COMPARED = 1e-6


def posterior_estimate(evidence: Evidence, trained: Trained, history: History) -> Estimate:
    """Means, standard deviations, parameters and summary of trained networks, one for every record."""
    hidden = coherent_misfit(evidence.equations.columns, evidence.each_record(parameter_force, trained))
    common = {
        "iterations": len(history.rows),
        "factorisations": history.factorisations,
        "stop_reason": "converged" if trained.solution.converged else "iteration limit",
        "log_evidence": trained.log_evidence,
        **({"model_log_evidence": model_log_evidence(evidence, trained)} if evidence.equations.unknown.any() else {}),
        "parameter_spread": trained.noise.spread,
    }
    table = history.table()
    estimates = [
        replace(estimate, history=table, summary=common | estimate.summary)
        for estimate in evidence.each_record(record_estimate, trained)
    ]
    estimate = with_parameters(evidence, estimates, parameter_posterior(evidence.equations, trained, hidden))
    if len(estimates) > 1:
        return replace(estimate, disagreements=disagreements(evidence, trained))
    return replace(estimate, end=evidence.each_record(end_state, trained)[0])


def with_parameters(
    evidence: Evidence,
    estimates: Sequence[Estimate],
    posterior: tuple[list[ParameterEstimate], np.ndarray, ParameterKnowledge],
) -> Estimate:
    """One estimate of all records from that of each, with these parameters, their correlation, and what is known."""
    (parameters, correlation, known), records = posterior, []
    for estimate, problem, columns in zip(estimates, evidence.problem, evidence.equations.columns, strict=True):
        places = columns[: len(problem.uncertain)]
        own = [replace(parameters[i], parameter=p) for i, p in zip(places, problem.uncertain, strict=True)]
        records.append(replace(estimate, parameters=own, correlation=correlation[np.ix_(places, places)]))
    joint = replace(records[0], parameters=parameters, correlation=correlation, known=known)
    return replace(joint, records=tuple(records)) if len(records) > 1 else joint


def record_estimate(evidence: RecordEvidence, solution: RecordSolution) -> Estimate:
    """Motion, forces, and the noise of one record; without the parameters, which other records may have in common."""
    equations, point = evidence.equations, solution.point
    posterior = ReadoutPosterior(equations, point, solution.factor)
    motion = (equations.flat_states(segments, point) for segments in (equations.observation, equations.forces))
    response = estimated_response(equations.problem.record, equations.dynamics, equations.parameters(point), *motion)
    std = _deviations(posterior, response)
    response, std = _share_force(evidence, solution, response, std)
    summary = {
        "features_per_dof": equations.network.count,
        "operations_per_factorisation": solution.factor.readout.operations,
    }
    taken, _ = values_taken(evidence, solution)
    noise = FoundNoise(
        {FORCE: solution.noise.force[: equations.problem.record.ndof], **_noise_felt(equations, solution)},
        solution.noise.discrepancy / equations.refinement**0.5,
        {group.name: np.where(group.present, taken[group.name], np.nan) for group in equations.channels},
    )
    summary |= _of_unknown_forces(evidence, solution)
    known = equations.known_parameters
    if known is not None:
        summary["spectral_misfit"] = known.misfit
    connections, misfit = _connections(posterior, response), misfit_history(evidence, solution)
    left = {
        name: samples
        for channels in equations.channels
        for name, samples in channels.residuals_of_samples(point).items()
    }
    return Estimate(
        response,
        std,
        [],
        pd.DataFrame(),
        summary,
        noise=noise,
        connections=connections,
        misfit=misfit,
        left=left,
        damping_doubt=None if known is None else known.damping_doubt,
    )


def _noise_felt(equations: NormalEquations, solution: RecordSolution) -> dict[str, np.ndarray]:
    """Quantity to the noise of its sensors in what they feel; of calibrated ones by themselves as well."""
    record = equations.problem.record
    levels = {quantity: sigma.copy() for quantity, sigma in solution.noise.response.items()}
    if CALIBRATED not in levels:
        return levels
    gain = equations.parameters(solution.point)["gain"].numpy()
    levels[CALIBRATED] /= np.abs(gain)
    for channel, sigma in zip(record.calibrated, levels[CALIBRATED], strict=True):
        quantity, number = channel.place
        levels[quantity][number] = sigma
    return levels


def _of_unknown_forces(evidence: RecordEvidence, solution: RecordSolution) -> dict[str, float]:
    """Correlation time (s), standard deviation (N, m/s^2) and misfit of what nobody measured, forces or the ground."""
    inputs = evidence.equations.problem.inputs
    if not inputs.unmeasured or solution.noise.innovation is None:
        return {}
    what, (std, misfit) = "force" if inputs.forces else "ground", std_and_misfit(evidence, solution)
    told = {f"correlation_time_unknown_{what}": inputs.correlation_time, f"std_unknown_{what}": std}
    return told if misfit is None else told | {f"misfit_unknown_{what}": misfit}


def _connections(posterior: ReadoutPosterior, response: Response) -> ConnectionHistories:
    """Drifts, sums of functions whose errors are not independent, and forces of :attr:`Structure.added`."""
    dynamics, segments = posterior.equations.dynamics, posterior.equations.observation
    structure = dynamics.structure
    motion, _ = response.stretching
    forces, energy = [np.zeros((len(motion), 0))] * 2, [np.zeros(0)] * 2
    if len(structure.added):
        forces, energy = list(connection_forces(posterior)), list(dissipated_energy(posterior))
    drifts = structure.drifts
    std = np.zeros((len(motion), 0))
    if drifts.shape[0]:
        by_function = csr_matrix(drifts @ dynamics.picked(dynamics.stretch_places))
        std = posterior.combined(segments, [(0, by_function)]).numpy()
    return ConnectionHistories(motion @ drifts.T, std, *forces, *energy)


def _deviations(posterior: ReadoutPosterior, response: Response) -> Response:
    """Standard deviations of everything in a response, before what load cells add to the force."""
    equations = posterior.equations
    dynamics = equations.dynamics
    sensed = posterior.sensed(equations.observation)
    functions = None if dynamics.is_plain else posterior.functions(equations.forces)[0]
    if dynamics.structure.is_modal:
        force = torch.zeros_like(sensed["displacement"])
    else:
        force = posterior.force(equations.forces)
    if functions is not None:
        force[:, dynamics.loaded] = functions[:, dynamics.acting]
    displacement, velocity, acceleration = (sensed[quantity].numpy() for quantity in RESPONSE_QUANTITIES)
    supports = None
    if response.supports is not None:
        moved = posterior.functions(equations.observation)
        supports = np.stack([std[:, dynamics.supports].numpy() for std in moved], axis=1)
    return Response(
        response.time,
        displacement,
        velocity,
        acceleration,
        force.numpy(),
        sensed[GROUND][:, 0].numpy() if dynamics.inputs.ground else None,
        None if functions is None or response.hidden is None else functions[:, dynamics.hidden].numpy(),
        supports=supports,
    )


def _share_force(
    evidence: RecordEvidence, solution: RecordSolution, response: Response, std: Response
) -> tuple[Response, Response]:
    """The force that acts, with its standard deviation."""
    equations, noise = evidence.equations, solution.noise
    forced = equations.problem.record.sensors("force")
    if not forced.any() or equations.dynamics.inputs.loads:
        return response, std
    measured = equations.problem.record.force
    filtered = evidence.followed_force()
    share, sigma = (x[: len(forced)][forced] for x in (sensor_share(noise), noise.force))
    # Both variances count N samples for the K values that the features can tell apart.
    seen = min(equations.network.count / len(measured), 1.0)
    force_std = std.force.copy()
    force_std[:, forced] = np.sqrt(((1 - share) * force_std[:, forced]) ** 2 + seen * share * sigma**2)
    return acting_force(response, filtered, noise), replace(std, force=force_std)


def disagreements(evidence: Evidence, trained: Trained) -> tuple[Disagreement, ...]:
    """How far every record pulls the parameters from where all of them ended, against chance.

    The pull is what its own misfit falls with the parameters, its motion following them. With the record's information
    S and the covariance C of all records together it has the covariance S - S C S if all measured one structure.
    """
    equations, out = evidence.equations, []
    covariance = trained.factor.corner_covariance
    at, scale = trained.solution.point.parameters.numpy(), equations.scale
    precision = equations.precision(trained.noise).numpy()
    start = np.array([p.prescribed for p in equations.uncertain])
    each = zip(equations.columns, evidence.each_record(own_information, trained), strict=True)
    for columns, (whole, whole_pull) in each:
        # A bound holds others back, and says nothing about chance.
        free = at[columns] > equations.lower[columns]
        places, information, pull = columns[free], whole[np.ix_(free, free)], whole_pull[free]
        square, freedom = _against_chance(information, pull, covariance[np.ix_(places, places)])
        alone = at[places] + np.linalg.solve(information + np.diag(precision[places]), pull)
        values = start[places] + scale[places] * alone
        names = [equations.uncertain[i].name for i in places]
        out.append(Disagreement(square, freedom, dict(zip(names, values.tolist(), strict=True))))
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


def sensor_share(noise: NoiseModel) -> np.ndarray:
    """(functions,) weight of the measured force in the posterior mean, from 0 to 1; NaN where there is no load cell.

    The residual between the motion's force and the measured one is discrepancy plus sensor noise, so each is weighted
    by the other's variance.
    """
    model = noise.discrepancy**2
    return model / (model + noise.points_per_sample * noise.force**2)


def acting_force(response: Response, filtered: np.ndarray, noise: NoiseModel) -> Response:
    """The response with the posterior mean of the force on every DOF that has a load cell.

    Without model error that is the motion's force; with a model that is far off it is the filtered measurement.
    Elsewhere the force stays what the motion takes: on an unforced DOF it shows where the model is wrong.

    Args:
        response: Its force is the one that the motion takes.
        filtered: (N, n), the measured force as far as the features follow it.
        noise: Of sensors and model, in the same sampling.
    """
    forced = np.isfinite(noise.force[: response.force.shape[1]])
    share, force = sensor_share(noise)[: len(forced)][forced], response.force.copy()
    force[:, forced] += share * (filtered[:, forced] - force[:, forced])
    return replace(response, force=force)


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
) -> list[tuple[np.ndarray, float, np.ndarray, int | None]]:
    """Of every measured input that has noise: what one unit puts into the equations (n,); it; samples; its function."""
    equations, noise, record = evidence.equations, solution.noise, evidence.problem.record
    dynamics, structure = equations.dynamics, equations.dynamics.structure
    loads, inputs = dynamics.inputs.loads, []
    for dof in np.flatnonzero(record.sensors(FORCE)):
        function = dynamics.loads.start + loads.index(dof) if loads else None
        sigma = (noise.response[FORCE] if loads else noise.force)[dof]
        inputs.append((structure.shapes.matrix[dof], float(sigma), record.force[:, dof], function))
    if dynamics.inputs.ground and record.measured_ground is not None:
        pushed = -equations.parameters(solution.point)[MASS].detach().numpy() * structure.with_ground
        sigma = noise.response[GROUND][0]
        inputs.append((pushed, float(sigma), record.measured_ground, dynamics.ground.start))
    return [one for one in inputs if np.isfinite(one[1]) and one[1] > 0.0]
