"""How probable a record is under a model: an evidence that compares models with each other.

That of :mod:`pinn_cli.training.evidence` is known up to constants of the features and of the hidden functions: it
compares noise levels and parameters of one model. Here what the equations say of the motion is a density that
integrates to one, whatever the features and however many functions there are: log p(sensors | forces, model) is

    -1/2 [chi^2 + sum of log variances + log det H - log det P] + the parameters' part,

with H the Hessian by the readout weights and P that of the equations alone, without the sensors. Measured forces are
given; what they have beyond the features' reach says nothing about a motion. Free vibrations, of which the equations
say nothing, are as large as what the sensors saw, to one standard deviation.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from pinn_cli.training.evidence import Evidence, Trained
from pinn_cli.training.noise_model import NoiseModel
from pinn_cli.training.record_evidence import OF_PARAMETERS, RecordEvidence, RecordSolution


def model_log_evidence(evidence: Evidence, trained: Trained) -> float:
    """Natural logarithm of the density of all sensors' samples, SI units, with motion and parameters integrated out.

    NaN where the equations alone cannot be solved, or a sensor is compared with what the equations say of it.
    """
    terms = evidence.each_record(sensors_term, trained)
    return float(sum(terms)) + evidence.parameter_term(trained.solution.point, trained.noise, trained.factor)


def sensors_term(evidence: RecordEvidence, solution: RecordSolution) -> float:
    """One record's part; see :func:`model_log_evidence`."""
    equations, point, noise = evidence.equations, solution.point, solution.noise
    losses, forces = equations.losses(point, noise), evidence.force_residuals(point, noise)
    if forces.observer is not None:
        return math.nan
    alone = equations.assemble(point, of_motion(evidence, noise)).eliminated()
    if alone is None:
        return math.nan
    physics = float((forces.seen / noise.physics_variance)[forces.enforced].sum())
    rest = sum(value for name, value in losses.items() if name not in ("physics", *OF_PARAMETERS))
    change = solution.factor.readout.log_determinant - alone.readout.log_determinant
    return -0.5 * (physics + rest + evidence.log_variances(noise) + _count(evidence) * math.log(2.0 * math.pi) + change)


def _count(evidence: RecordEvidence) -> int:
    """Samples of all response sensors."""
    return int(sum(channels.samples[channels.present].sum() for channels in evidence.equations.channels))


def of_motion(evidence: RecordEvidence, noise: NoiseModel) -> NoiseModel:
    """Sensors that together say of the motion how large it is, and no more."""
    response = dict(noise.response)
    for channels in evidence.equations.channels:
        # Of each sample the deviation with which all of them together say the root mean square.
        size = channels.numbers("rms") * np.sqrt(channels.samples)
        response[channels.name] = np.where(size > 0.0, size, np.where(channels.present, 1.0, np.nan))
    return replace(noise, response=response)
