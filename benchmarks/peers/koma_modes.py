"""Frequencies and damping of a frame with KOMA, covariance-driven SSI: python koma_modes.py record.csv modes.csv."""

import sys

import numpy as np
from koma.oma import covssi, find_stable_poles

record = np.loadtxt(sys.argv[1], delimiter=",", skiprows=1)
rate = 1 / (record[1, 0] - record[0, 0])

# Tuned with the truth, as only a benchmark may.
BLOCK_ROWS = 120
ORDERS = np.arange(10, 42, 2)
FREQUENCY, DAMPING, SHAPE = 0.01, 0.05, 0.05  # within which a pole is stable from order to order
STABLE_FOR = 4  # orders
NEAR = [1.64, 4.75, 7.34, 9.14, 10.49]  # Hz, where the modes are: which stable poles are modes is for the user to say

poles, shapes, orders = covssi(record[:, 1:], rate, BLOCK_ROWS, ORDERS, showinfo=False)
limits = {"freq": FREQUENCY, "damping": DAMPING, "mac": SHAPE}
stable, *_ = find_stable_poles(poles, shapes, orders, STABLE_FOR, stabcrit=limits)
stable = np.asarray(stable)
hz, damping = np.abs(stable) / (2 * np.pi), -stable.real / np.abs(stable)
modes = []
for frequency in NEAR:
    near = np.abs(hz / frequency - 1) < 0.05
    modes.append([np.median(hz[near]), np.median(damping[near])])
np.savetxt(sys.argv[2], modes, delimiter=",", header="frequency,damping_ratio", comments="")
