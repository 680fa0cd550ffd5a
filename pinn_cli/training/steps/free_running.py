"""Parameters with which the structure runs free.

There are two stories of a record that the model does not quite explain. In one a force that it leaves out acts on every
coordinate: then the motion follows the sensors, which is best for the motion, and of the parameters no more is left
than a regression of forces on it. In the other the structure runs free, and what it misses of the record is an error of
the response: then the parameters are those of an output-error fit (Ljung 1999, section 7.3), with which the structure
does what the record shows better than with any others. The second is the first with a discrepancy that goes to nothing
while the sensors' noise follows what is left. So it is found from the first, step by step.

What is left of the sensors is no white noise then. So the covariance is that of a misspecified model (White 1982),
S^-1 (J + P) S^-1, with S the precision under white noise, P that of the prior, and J the covariance of the score, from
sums of it over parts of the record that are long enough to be independent.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from pinn_cli.training.evidence import Evidence, Trained
from pinn_cli.training.levels import SETTLED, floor
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.record_evidence import RecordEvidence, RecordSolution
from pinn_cli.training.solver import FreeRunning, Inference
from pinn_cli.training.steps.discrepancy_search import DECISIVE_DROP, SCAN_FACTOR

# A load cell's noise would take up as much of a model error as it may: a free run is one under the measured force.
FORCE_LEFT = 0.03
# Parts of the first discrepancy: the last one moves a structure by nothing beside what the sensors are off by then.
PARTS_LEFT = (1e-2, 1e-3, 1e-4)
# Rounds at most to each, and those in a row whose solution is not reached: then there is none that could be.
FREE_ROUNDS, UNREACHED = 15, 2
# Parts of a record that a score is summed over, and how many of them in a row are as good as independent of others.
CELLS, CELLS_IN_A_ROW = 200, 20
# Parts that overlap count for one and a half times as many that do not.
FREEDOM = 1.5 * CELLS / CELLS_IN_A_ROW - 1.0


def fit_free_run(inference: Inference) -> Inference | None:
    """The same with solutions whose structure runs free, each with less of a discrepancy; None: the motion does that.

    A spline does not follow every motion of a structure that runs free, so the last one need not be the best. Where a
    force is free nothing tells it from what the model leaves out; windows and samplers go on from the solution itself.
    """
    problem = inference.problem
    goes_on = inference.is_informed or problem.first.hand_over is not None or bool(problem.priors)
    if goes_on or problem.has_unknown_forces or not problem.identifies:
        return None
    evidence, last = inference.evidence, inference.trained
    floors = evidence.each_record(floor, last)
    if not _is_misled(evidence, last, floors):
        return None
    first, free = last.noise.records, []
    for part in PARTS_LEFT:
        ends = [max(part * noise.discrepancy, least.discrepancy) for noise, least in zip(first, floors, strict=True)]
        followed = _followed(evidence, last, ends, first)
        if followed is None:
            break
        last = followed
        if last.solution.converged:
            free.append(FreeRunning(last, *_deviations(evidence, last)))
    return replace(inference, free=free) if free else None


def _followed(evidence: Evidence, trained: Trained, ends: list[float], first: tuple[NoiseModel, ...]) -> Trained | None:
    """The solution with a discrepancy that has come down to its end, step by step; None where it cannot be solved."""
    unreached = 0
    for _ in range(FREE_ROUNDS):
        levels = tuple(evidence.each_record(_stiffer, trained, ends, first))
        again = evidence.train(replace(trained.noise, records=levels), trained.solution.point)
        if again is None or not np.isfinite(again.log_evidence):
            return None
        unreached = 0 if again.solution.converged else unreached + 1
        if unreached == UNREACHED:
            return None
        pairs = zip(again.noise.records, trained.noise.records, strict=True)
        moved = [np.abs(_log_response(new) - _log_response(old)) for new, old in pairs]
        trained = again
        settled = float(np.nanmax(np.concatenate(moved), initial=0.0)) < SETTLED
        if settled and all(noise.discrepancy <= end for noise, end in zip(levels, ends, strict=True)):
            break
    return trained


def _is_misled(evidence: Evidence, trained: Trained, least: list[NoiseModel]) -> bool:
    """Whether the record is far less probable without any discrepancy; or far more, where the search went astray.

    What is compared is the most probable discrepancy: one that was widened for its colour is less probable by itself.
    A tenth of it tells it mostly, and is solved in a few steps.
    """
    levels = [level.discrepancy * level.occupied**0.5 for level in trained.noise.records]
    if all(level <= SCAN_FACTOR * lowest.discrepancy for level, lowest in zip(levels, least, strict=True)):
        return False

    def log_evidence(part: float) -> float:
        """Under a part of the most probable discrepancy; -inf where that cannot be solved."""
        lower = (
            replace(noise, discrepancy=max(part * level, lowest.discrepancy))
            for noise, level, lowest in zip(trained.noise.records, levels, least, strict=True)
        )
        again = evidence.train(replace(trained.noise, records=tuple(lower)), trained.solution.point)
        return -np.inf if again is None else again.log_evidence

    is_widened = any(noise.occupied < 1.0 for noise in trained.noise.records)
    most_probable = log_evidence(1.0) if is_widened else trained.log_evidence
    return not all(abs(log_evidence(part) - most_probable) < DECISIVE_DROP for part in (SCAN_FACTOR**-2, 0.0))


def _stiffer(evidence: RecordEvidence, solution: RecordSolution, end: float, first: NoiseModel) -> NoiseModel:
    """Less of a discrepancy, and what is left of the response's sensors as an error that is as large a part of each.

    On top of the sensor's own noise. If each had a level of its own, one would be followed at the cost of the others.

    Args:
        evidence: Of one record.
        solution: The solution before.
        end: Of the discrepancy.
        first: Noise of the sensors, and of the inputs, which keep theirs.
    """
    # Of a part p, with r the residuals, a sensor's own noise s and its size z, r^2 = s^2 + p z^2: maximum likelihood
    # weighs each sensor by how well it tells as it is now (Fisher scoring).
    told, known, size = 0.0, 0.0, {}
    for channels in evidence.equations.channels:
        q, is_response = channels.name, channels.present & ~channels.acting
        if not is_response.any():
            continue
        residual = np.where(is_response, channels.squares(solution.point) / channels.samples, np.nan)
        size[q] = np.where(channels.present, is_response * channels.numbers("rms") ** 2, np.nan)
        precision = solution.noise.response[q] ** -4
        told += float(np.nansum(precision * size[q] * (residual - first.response[q] ** 2)))
        known += float(np.nansum(precision * size[q] ** 2))
    part = max(told, 0.0) / known if known > 0.0 else 0.0
    response = {q: np.sqrt(level**2 + part * size.get(q, 0.0)) for q, level in first.response.items()}
    discrepancy = max(solution.noise.discrepancy / SCAN_FACTOR, end)
    of_force = np.clip(discrepancy / (PARTS_LEFT[0] * first.discrepancy), FORCE_LEFT, 1.0)
    for name, i in evidence.input_channels:
        response[name][i] *= of_force
    return replace(solution.noise, response=response, force=of_force * first.force, discrepancy=discrepancy)


def _log_response(noise: NoiseModel) -> np.ndarray:
    return np.log(np.concatenate(list(noise.response.values())))


def _deviations(evidence: Evidence, trained: Trained) -> tuple[np.ndarray, np.ndarray]:
    """Covariance (p, p) and standard deviation (p,), see :class:`FreeRunning`."""
    white = trained.factor.corner_covariance
    scores, varying = np.zeros((len(white), len(white))), np.zeros(len(white))
    covariances = evidence.each_record(_score_covariance, trained)
    for columns, (of_score, of_condition) in zip(evidence.equations.columns, covariances, strict=True):
        scores[np.ix_(columns, columns)] += of_score
        varying[columns] += of_condition / len(covariances)
    prior = evidence.equations.precision(trained.noise).numpy()
    covariance = white @ (scores + np.diag(prior)) @ white
    # No residual tells more than white noise of its size.
    wider = np.sqrt(np.maximum(np.diag(white) / np.diag(covariance), 1.0))
    return covariance * np.outer(wider, wider), np.sqrt(varying)


def _score_covariance(evidence: RecordEvidence, solution: RecordSolution) -> tuple[np.ndarray, np.ndarray]:
    """(p, p) covariance of one record's score; (p,) variance of parameters over how loud it is, and when.

    Both from parts of the record. The parameters of a part are a step away, its own score and information tell which;
    their slope by a condition counts for what is beyond chance.
    """
    white = solution.factor.corner_covariance
    scores, information = (_in_parts(x) for x in _scores(evidence, solution))
    # Of a fit to the whole record the parts know, and few of them tell a variance roughly (Student 1908).
    correction = CELLS / CELLS_IN_A_ROW / (1.0 - CELLS_IN_A_ROW / CELLS) * FREEDOM / (FREEDOM - 2.0) / len(scores)
    of_score = correction * scores.T @ scores
    by_chance = np.diag(white @ of_score @ white)
    loud = 0.5 * np.log(np.trace(information @ white, axis1=1, axis2=2).clip(1e-12))
    varying = np.zeros(len(white))
    for condition in (loud, np.linspace(0.0, 1.0, len(scores))):
        moved = _slope(condition - condition.mean(), scores, information) * np.std(condition)
        varying += np.maximum(moved**2 - by_chance, 0.0)
    return of_score, varying


def _slope(condition: np.ndarray, scores: np.ndarray, information: np.ndarray) -> np.ndarray:
    """(p,), of parameters that change with a condition (W,), from scores (W, p) and information (W, p, p) of parts."""
    design, p = np.column_stack((np.ones(len(condition)), condition)), scores.shape[1]
    normal = np.einsum("wi,wj,wpq->ipjq", design, design, information).reshape(2 * p, 2 * p)
    slope: np.ndarray = np.linalg.lstsq(normal, np.einsum("wi,wp->ip", design, scores).ravel())[0][p:]
    return slope


def _in_parts(cells: np.ndarray) -> np.ndarray:
    """Sums over so many cells in a row, wherever they begin."""
    total = np.concatenate((np.zeros((1, *cells.shape[1:])), np.cumsum(cells, axis=0)))
    return total[CELLS_IN_A_ROW:] - total[:-CELLS_IN_A_ROW]


def _scores(evidence: RecordEvidence, solution: RecordSolution) -> tuple[np.ndarray, np.ndarray]:
    """(CELLS, p) slope of -log density by every parameter with the motion that follows it, (CELLS, p, p) information.

    In parts of the record.
    """
    equations, noise, point = evidence.equations, solution.noise, solution.point
    count, readout, steps = len(point.parameters), solution.factor.readout, []
    for direction in np.eye(count):
        followed = torch.as_tensor(-readout.solved(np.zeros(readout.size), direction)).to(point.unknowns)
        steps.append(Point(followed, torch.as_tensor(direction)))
    scores, information = np.zeros((CELLS, count)), np.zeros((CELLS, count, count))

    def add(residual: torch.Tensor, moved: list[torch.Tensor], first: int, total: int) -> None:
        """Of residuals (groups, ...) and what each step moves them by, over their noise."""
        rows = torch.stack(moved, dim=-1).reshape(len(residual), -1, count)
        place = (first + np.arange(len(residual))) * CELLS // total
        np.add.at(scores, place, torch.einsum("gs,gsp->gp", residual.reshape(len(residual), -1), rows).numpy())
        np.add.at(information, place, (rows.mT @ rows).numpy())

    # What acts on the structure is as it was measured: what its sensors leave says nothing of the model.
    for channels in (channels for channels in equations.channels if not channels.acting.all()):
        root = torch.as_tensor(np.nan_to_num(~channels.acting / noise.response[channels.name])).to(point.unknowns)
        for piece, (at, moved) in zip(channels.residuals(point), channels.moved(point, steps), strict=True):
            add(piece.residual * root[at], [change * root[at] for change in moved], piece.first, piece.groups)
    physics, of_physics = equations.motion.residual(point), equations.motion.weight(noise).sqrt()
    for part, forces in equations.motion.moved(point, steps):
        weight = of_physics if of_physics.ndim == 1 else of_physics[part]
        add(physics[part] * weight, [force * weight for force in forces], part.start, len(physics))
    return scores, information
