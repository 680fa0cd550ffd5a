"""Noise levels and parameters looked for in a part of a long record, and the whole record solved from there.

A search solves the problem many times, from soft physics to stiff. In a stationary record its first part shows nearly
the same model error and parameters as the whole. The whole is then searched from there on, in the last steps alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pinn_cli.network.linear_readout import LinearReadout
from pinn_cli.network.spline import SplineNetwork
from pinn_cli.record.record import Record
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import Problem
from pinn_cli.training.evidence import Evidence, Trained, converged
from pinn_cli.training.factors.frame import collocation_refinement
from pinn_cli.training.minimise import Point
from pinn_cli.training.noise_model import NoiseLevels
from pinn_cli.training.steps.discrepancy_search import SCAN_FACTOR, negligible, scanned

# Samples of a part, at least; a share of the record, at least. Levels of 20 000 samples are right to half a percent.
FEWEST_SAMPLES, SHARE = 20_000, 1 / 16
# Records of fewer such parts are searched whole: little would be gained.
FEWEST_PARTS = 2.5
# Factor between the root mean squares of part and whole, of any channel, up to which a record is stationary enough.
STATIONARY = 1.5
# Steps of the scan from the part's discrepancy beyond which the part is no picture of the whole.
NEAR_STEPS = 2
# Of a scan down to any discrepancy that is looked for.
MOST_SCAN_STEPS = 16


def part_of_record(whole: JointProblem, network: LinearReadout) -> tuple[Problem, SplineNetwork] | None:
    """The problem of the first part of a record, with the same knots there; None where a part is of no use.

    That is where a record is short or not stationary, where samples are missing or come at times of their own, where
    several records or an earlier one tell of the parameters, and where forces are unknown. Where no parameter is
    unknown, ten minutes of ten DOFs took as long either way. Scans of structures that are not linear take other
    steps in a part than in the whole, which would move what is reported.
    """
    problem, record = whole.first, whole.first.record
    informed = len(whole) > 1 or problem.prior is not None or problem.initial_state is not None
    irregular = bool(record.calibrated) or record.repeats is not None
    if informed or irregular or problem.inputs.unmeasured:
        return None
    if not (problem.identifies and problem.structure.has_linear_laws):
        return None
    if not isinstance(network, SplineNetwork) or network.channels > 1:
        return None
    wanted = max(FEWEST_SAMPLES, round(SHARE * len(record.time)))
    if len(record.time) < FEWEST_PARTS * wanted:
        return None
    # So many intervals are a whole number of samples, and the part ends as the whole does.
    refinement = collocation_refinement(network, record)
    intervals = refinement * (round(wanted * record.step / network.spacing) // refinement + 1)
    samples = intervals * network.spacing / record.step
    if abs(samples - round(samples)) > 1e-6 * samples or not _is_stationary(record, round(samples)):
        return None
    stop = network.start + intervals * network.spacing
    shape = intervals, network.degree, network.continuity, network.readout.dtype
    part = replace(problem, record=record.until(round(samples)))
    return part, SplineNetwork(network.ndof, network.start, stop, *shape)


def _is_stationary(record: Record, samples: int) -> bool:
    """Whether all channels are as strong in the first samples as in the whole."""
    for quantity in (*record.response_quantities, "force"):
        values = record.histories(quantity)[:, record.sensors(quantity)]
        part, whole = (np.sqrt(np.mean(x**2, axis=0)) for x in (values[:samples], values))
        if np.any(part > STATIONARY * whole) or np.any(whole > STATIONARY * part):
            return False
    return True


def whole_from(
    part: Trained, of_part: Evidence, largest: float, evidence: Evidence, noise: NoiseLevels
) -> Trained | None:
    """The most probable discrepancy of the whole record, looked for where its part has it; None where it is not there.

    The last steps of a search in all of the record: of the same discrepancies, under the noise that its sensors show.

    Args:
        part: The solution of the part, with its parameters and its discrepancy.
        of_part: The evidence of the part.
        largest: Discrepancy where its search began, N.
        evidence: Of the whole.
        noise: Where a search of the whole would begin.
    """
    equations, record_equations = evidence.equations, evidence.equations.by_record[0]
    equations.share_ridges(of_part.equations)
    noise, largest_of_whole = replace(noise, spread=part.noise.spread), noise.discrepancy
    steps = round(float(np.log(largest / part.noise.discrepancy) / np.log(SCAN_FACTOR)))
    # How far a scan goes beyond the first discrepancy that makes no motion better known is chance.
    least = negligible(record_equations, noise.records[0])
    to_least = int(np.ceil(np.log(largest_of_whole / least) / np.log(SCAN_FACTOR))) if least > 0 else MOST_SCAN_STEPS
    steps = min(steps, to_least)
    # A scan of the whole would take one step, then two at a time: from an odd one on both try the same discrepancies.
    begin = noise.with_discrepancy(largest_of_whole / SCAN_FACTOR ** max(steps - 1 + steps % 2, 0))
    point = Point(equations.start().unknowns, part.solution.point.parameters)
    whole = converged(scanned(evidence, noise, begin.discrepancy, equations.followed(point, begin)))
    furthest = begin.discrepancy / SCAN_FACTOR ** (NEAR_STEPS + 0.5)
    return whole if whole is not None and whole.noise.discrepancy > furthest else None
