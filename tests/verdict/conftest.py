"""A frame of three storeys under a force on its roof, with an accelerometer on every floor, and an estimate of it."""

import numpy as np
import pandas as pd
import pytest
from frame_records import measure, measurements
from small_estimates import other_estimate, parameter_estimate
from small_problems import small_chain

from pinn_cli.record.record import Record
from pinn_cli.record.response import Response
from pinn_cli.scheme.problem import Problem
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import Estimate
from pinn_cli.training.noise_model import FoundNoise


@pytest.fixture(scope="session")
def frame() -> Structure:
    return small_chain("linear", 3)


@pytest.fixture(scope="session")
def frame_record(frame: Structure) -> Record:
    return measure(frame)


@pytest.fixture
def problem(right_estimate: tuple[Problem, Estimate]) -> Problem:
    return right_estimate[0]


@pytest.fixture
def estimate(right_estimate: tuple[Problem, Estimate]) -> Estimate:
    return right_estimate[1]


@pytest.fixture(scope="session")
def right_estimate(frame: Structure) -> tuple[Problem, Estimate]:
    """A problem whose stiffnesses are unknown, and an estimate that is the truth."""
    simulated = measurements(frame)
    record, truth = simulated.record.keep({"acceleration": (1, 2, 3)}), simulated.truth.response
    noise = [float(np.std(record.acceleration[:, i] - truth.acceleration[:, i])) for i in range(3)]
    cell = float(np.std(record.force[:, 2] - truth.force[:, 2]))
    std = Response(record.time, *(np.full(truth.force.shape, 1e-3 * np.std(truth.displacement)) for _ in range(4)))
    unknown = tuple(Parameter("k", i, 10.0, 100.0, unknown=True, positive=True) for i in range(3))
    believed = tuple(Parameter("c", i, 1.0, 0.075) for i in range(3))
    parameters = [parameter_estimate(f"k_{i}", 10.0, 15.0, 0.01, 14.98, 15.02, 100.0, True) for i in (1, 2, 3)]
    parameters = [other_estimate(p, positive=True) for p in parameters]
    parameters += [parameter_estimate(f"c_{i}", 1.0, 1.0, 0.01, 0.98, 1.02, 0.075) for i in (1, 2, 3)]
    summary = {"stop_reason": "converged", "parameter_spread": 0.5}
    levels = FoundNoise({"force": np.array([np.nan, np.nan, cell]), "acceleration": np.array(noise)}, 1e-4)
    found = Estimate(truth, std, parameters, pd.DataFrame(), summary, noise=levels)
    return Problem(frame, record, unknown + believed), found
