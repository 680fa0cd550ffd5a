"""What a record does not say of parameters: the frequencies beyond the end of the forces that nobody measured.

Unknown forces are processes that go on above the band where forces act. That a sensor shows next to nothing up there
would tell of a structure that passes nothing on: of 16 records of cubic storeys in a wind that ends below the record's
band, stiffnesses came out up to 5 standard deviations too small. Counted up to the end alone, they are as far off as
they should be.
"""

from __future__ import annotations

import numpy as np

from pinn_cli.system.quantities import MOTION
from pinn_cli.training.factors.feels import weighted
from pinn_cli.training.minimise import Point
from pinn_cli.training.record_evidence import RecordEvidence, RecordSolution
from pinn_cli.training.steps.force_spectrum import end_of_forces

# Frequencies at most at which what lies beyond the end is looked at: a resonance there must be among them.
FREQUENCIES_BEYOND = 1024
# Part of a parameter's standard deviation that its derivative is the difference over.
PART_OF_STD = 0.1


def log_density_beyond(evidence: RecordEvidence, solution: RecordSolution, end: float, point: Point) -> float:
    """Whittle's log likelihood at a point of sensors that show their noise alone from a frequency (Hz) on.

    Of the equations linearised at the motion, on the average over the record: -sum of log det S + tr S^-1 R, with R the
    noise and S what the process of the forces makes of the sensors beside it.
    """
    equations = evidence.equations
    dynamics, noise, record = equations.dynamics, solution.noise, equations.problem.record
    assert noise.innovation is not None
    forces = np.arange(dynamics.forces.start, dynamics.forces.stop)
    lines = (_top(evidence) - end) * record.step * len(record.time)
    number = min(FREQUENCIES_BEYOND, max(1, round(lines)))
    s = 2j * np.pi * (end + (_top(evidence) - end) * (np.arange(number) + 0.5) / number)[:, None, None]
    mass, damping, stiffness = evidence.mean_equations(point)
    driven = np.zeros((dynamics.size, len(forces)))
    # White noise of the points has so much power per frequency less than that of the samples.
    driven[forces, np.arange(len(forces))] = noise.innovation[forces] / equations.refinement**0.5
    moved = np.linalg.solve(
        stiffness + s * damping + s**2 * np.diag(mass), np.broadcast_to(driven, (len(s), *driven.shape))
    )
    sensors = {place: sensor.channel for place, sensor in evidence.sensors.items() if sensor.channel.quantity in MOTION}
    rows = np.zeros((len(s), len(sensors), dynamics.size), dtype=complex)
    for i, channel in enumerate(sensors.values()):
        for function, order, weight in weighted(dynamics, channel.quantity, channel.weights):
            rows[:, i, function] += weight * s[:, 0, 0] ** order
    noise_of = np.array([noise.response[name][i] for name, i in sensors])
    shown = rows @ moved / noise_of[:, None]  # in units in which R is the identity
    spectrum = np.eye(len(sensors)) + shown @ shown.conj().transpose(0, 2, 1)
    of_noise = np.trace(np.linalg.inv(spectrum), axis1=1, axis2=2).real
    return -lines * float((np.linalg.slogdet(spectrum)[1] + of_noise).mean())


def slope_beyond(evidence: RecordEvidence, solution: RecordSolution, std: np.ndarray) -> np.ndarray:
    """(p,) slope of :func:`log_density_beyond` by prior deviations; zeros where forces do not end.

    Args:
        evidence: Of one record.
        solution: Its solution.
        std: (p,), posterior standard deviations of the parameters, in prior ones; 0 of those that are not asked for.
    """
    end, slope = end_of_forces(evidence, solution), np.zeros(len(std))
    for i in np.flatnonzero(std if end < _top(evidence) else slope).tolist():
        width = PART_OF_STD * float(std[i])
        above, below = (log_density_beyond(evidence, solution, end, at) for at in solution.point.beside(i, width))
        slope[i] = (above - below) / (2.0 * width)
    return slope


def _top(evidence: RecordEvidence) -> float:
    """Hz, up to which both the samples and the features tell something."""
    return 0.5 * min(1.0 / evidence.equations.problem.record.step, evidence.equations.network.free_intervals)
