"""Make rig.csv: three storeys on a bench, a shaker on the first one, a load cell and three accelerometers.

With NumPy and SciPy alone: `python make_rig.py`. The storeys have 40, 36 and 44 kN/m.
"""

from pathlib import Path

import numpy as np
import pandas as pd
from scipy.signal import lsim

RATE, SECONDS, FINER = 250, 12, 8  # Hz, s, steps of the simulation in one of the record
NOISE = 0.02  # of each sensor, over its root mean square
MASS, DAMPING, STIFFNESS = 5.2, 15.0, [40e3, 36e3, 44e3]  # kg, N s/m, N/m


def record() -> pd.DataFrame:
    """Time t in s, force f1 on the first storey in N, accelerations a1 to a3 in m/s^2."""
    rng = np.random.default_rng(7)
    t = np.arange(FINER * RATE * SECONDS) / (FINER * RATE)
    hz = np.arange(1, 40, 0.25)
    force = 4 * np.sin(2 * np.pi * (np.outer(t, hz) + rng.random(len(hz)))).sum(1)
    drift = np.array([[1, 0, 0], [-1, 1, 0], [0, -1, 1]])  # of each storey, from the motion of the floors
    system = np.zeros((6, 6))
    system[:3, 3:] = np.eye(3)
    system[3:, :3] = -drift.T @ np.diag(STIFFNESS) @ drift / MASS
    system[3:, 3:] = -drift.T @ drift * DAMPING / MASS
    pushed = np.array([[0], [0], [0], [1 / MASS], [0], [0]])
    _, _, state = lsim((system, pushed, np.eye(6), np.zeros((6, 1))), force, t)
    acceleration = state @ system[3:].T + np.outer(force, pushed[3:])
    clean = np.column_stack([force, acceleration])[::FINER]
    measured = clean + NOISE * clean.std(0) * rng.standard_normal(clean.shape)
    return pd.DataFrame(np.column_stack([t[::FINER], measured]), columns=["t", "f1", "a1", "a2", "a3"])


if __name__ == "__main__":
    record().to_csv(Path(__file__).with_name("rig.csv"), index=False, float_format="%.6g")
