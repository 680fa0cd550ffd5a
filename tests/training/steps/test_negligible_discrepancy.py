"""How stiff physics may get: far beyond what is negligible, rounding is all that is left of slow motion."""

import numpy as np
from ambient_records import ambient_record, frame
from solved_records import by_spline
from storeys import chain_matrix

from pinn_cli.scheme.sparse_recovery import SparseRecovery

FIRST, RATE, DURATION, EDGE, CORNER = 8.0, 400.0, 10.0, 40.0, 4.0


def closed_form_deviation(noise: float) -> float:
    """Of the displacement, rms over all floors and times: a linear structure's Gaussian posterior, line by line, m."""
    (m, c, k), total, step = frame(2, FIRST), 0.0, 1.0 / DURATION
    flat = 100.0**2 / (CORNER * np.arctan(EDGE / CORNER))  # one-sided, N^2/Hz: forces have 100 N rms
    for frequency in np.arange(step, 0.5 * RATE, step):
        omega = 2.0 * np.pi * frequency
        receptance = np.linalg.inv(chain_matrix(k) - omega**2 * np.diag(m) + 1j * omega * chain_matrix(c))
        force = flat / (1.0 + (frequency / CORNER) ** 2) * (1.0 if frequency <= EDGE else 1e-6)
        prior = np.linalg.inv(receptance @ receptance.conj().T * force)
        known = np.linalg.inv(prior + omega**4 / (2.0 * noise**2 / RATE) * np.eye(2))
        total += np.trace(known).real * step / 2.0
    return float(np.sqrt(total))


def test_bands_of_slow_motion_under_coloured_forces_are_as_wide_as_accelerometers_leave_it():
    made = ambient_record(FIRST, RATE, DURATION, EDGE, corner=CORNER, floors=2, sensors=(0, 1), seed=3)
    problem = SparseRecovery(parameter_uncertainty=0.0).pose(made.structure, [made.record])
    estimate = by_spline(problem)
    found = float(np.sqrt(np.mean(estimate.std.displacement**2)))
    assert 0.7 < found / closed_form_deviation(made.noise) < 1.6
