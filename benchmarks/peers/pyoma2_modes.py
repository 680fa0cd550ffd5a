"""Frequencies and damping of a frame by pyOMA2, covariance-driven SSI: python pyoma2_modes.py record.csv modes.csv."""

import sys

import numpy as np
from pyoma2.algorithms import SSI, SSIRunParams
from pyoma2.setup import SingleSetup

record = np.loadtxt(sys.argv[1], delimiter=",", skiprows=1)

# Tuned with the truth, as only a benchmark may.
BLOCK_ROWS = 120
HIGHEST_ORDER = 40
NEAR = [1.64, 4.75, 7.34, 9.14, 10.49]  # Hz, where the modes are: which stable poles are modes is for the user to say

setup = SingleSetup(record[:, 1:], fs=1 / (record[1, 0] - record[0, 0]))
subspace = SSI(SSIRunParams(method="cov", br=BLOCK_ROWS, ordmax=HIGHEST_ORDER), name="subspace")
setup.add_algorithms(subspace)
setup.run_by_name("subspace")
setup.mpe("subspace", sel_freq=NEAR, order_in="find_min")
found = np.column_stack([subspace.result.Fn, subspace.result.Xi])
np.savetxt(sys.argv[2], found, delimiter=",", header="frequency,damping_ratio", comments="")
