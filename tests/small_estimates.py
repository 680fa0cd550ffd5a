"""A small estimate, its record and its truth, of any number of DOFs: sums of sinusoids, no physics."""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from pinn_cli.record.record import Record, Truth
from pinn_cli.record.response import QUANTITIES, Response
from pinn_cli.report.results import Results, RunDescription
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing
from pinn_cli.system.parameters import LINEAR_TITLES, LINEAR_UNITS, Parameter
from pinn_cli.training.estimate import Estimate, ParameterEstimate


@dataclass(frozen=True)
class Case:
    estimate: Estimate
    record: Record
    truth: Truth
    labels: dict[str, object]


def _waves(time: np.ndarray, ndof: int, amplitude: float, seed: int) -> np.ndarray:
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, (5, ndof))
    frequencies = np.linspace(0.1, 0.9, 5)[:, None]
    return amplitude * np.cos(2.0 * np.pi * time[:, None, None] * frequencies + phases).sum(axis=1)


def _response(time: np.ndarray, ndof: int) -> Response:
    force = _waves(time, ndof, 1.0, 3)
    force[:, 1:] = 0.0
    motion = (_waves(time, ndof, amplitude, seed) for seed, amplitude in enumerate((0.1, 0.2, 0.5)))
    return Response(time, *motion, force)


def parameter_named(name: str) -> Parameter:
    """Of a Duffing chain: ``kappa_2``."""
    kind, _, number = name.rpartition("_")
    units, titles = LINEAR_UNITS | Duffing().units, LINEAR_TITLES | Duffing().titles
    return Parameter(kind, int(number) - 1, unit=units.get(kind, ""), title=titles.get(kind, ""))


def parameter_estimate(
    name: str,
    prescribed: float,
    estimate: float,
    std: float,
    lower_90: float,
    upper_90: float,
    prior_std: float = float("nan"),
    unknown: bool = False,
) -> ParameterEstimate:
    believed = replace(parameter_named(name), prescribed=prescribed, prior_std=prior_std, unknown=unknown)
    return ParameterEstimate(believed, estimate, std, lower_90, upper_90)


def other_estimate(given: ParameterEstimate, **changes: object) -> ParameterEstimate:
    """With other values of what was found, and of what was believed of the parameter."""
    believed = {
        name: changes.pop(name)
        for name in ("kind", "prescribed", "prior_std", "said", "unknown", "positive", "unit", "title")
        if name in changes
    }
    return replace(given, parameter=replace(given.parameter, **believed), **changes)


def _parameters(ndof: int) -> list[ParameterEstimate]:
    nominal = {"c": 1.0, "k": 15.0, "kappa": 100.0}
    return [
        parameter_estimate(f"{symbol}_{i}", value, 1.01 * value, 0.02 * value, 0.98 * value, 1.04 * value)
        for symbol, value in nominal.items()
        for i in range(1, ndof + 1)
    ]


def _history(iterations: int = 8) -> pd.DataFrame:
    steps = np.arange(iterations)
    return pd.DataFrame(
        {
            "iteration": steps,
            "seconds": 0.1 * steps,
            "loss_physics_forced": 10.0**-steps,
            "loss_prior": np.zeros(iterations),
            "weight_physics_forced": 10.0 ** (steps / 4.0),
        }
    )


def make_estimate(ndof: int = 6, observed: int = 2, samples: int = 400, duration: float = 20.0) -> Case:
    time = np.linspace(0.0, duration, samples)
    truth = _response(time, ndof)
    error = {quantity: 0.02 * _waves(time, ndof, 0.1, 9) for quantity in QUANTITIES}
    response = Response(time, **{quantity: getattr(truth, quantity) + error[quantity] for quantity in QUANTITIES})
    std = Response(time, **{quantity: np.full((samples, ndof), 0.01) for quantity in QUANTITIES})
    nothing = np.full((samples, ndof), np.nan)
    acceleration = np.where(np.arange(ndof) < observed, truth.acceleration + 0.01, np.nan)
    record = Record(time, nothing, nothing, acceleration, truth.force, np.arange(ndof) > 0)
    parameters = {"m": np.ones(ndof), "c": np.ones(ndof), "k": np.full(ndof, 15.0), "kappa": np.full(ndof, 100.0)}
    labels: dict[str, object] = {
        "case": "small", "estimator": "pinn", "scheme": "sparse_recovery", "ndof": ndof, "nonlinearity": "duffing",
        "model_error": "none", "snr_db": 50.0, "seed": 0,
    }  # fmt: skip
    estimate = Estimate(response, std, _parameters(ndof), _history(), {})
    return Case(estimate, record, Truth(truth, parameters), labels)


def results_of(case: Case, **changes: object) -> Results:
    """What a run of a Duffing chain hands to its report."""
    run = RunDescription("small", 0, 1, "", case.labels, True, "none", "kalman_smoother")
    structure = build_chain(case.record.ndof, Duffing(), m=1.0, c=1.0, k=15.0, kappa=100.0)
    return replace(Results(run, structure, case.record, case.truth, case.estimate), **changes)
