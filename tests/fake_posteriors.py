"""Fake posteriors that look like the paper's: stiffness and its nonlinear part strongly correlated."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from small_estimates import parameter_named

from pinn_cli.posterior.posterior import ForcePredictive, PosteriorResult, PosteriorSamples
from pinn_cli.record.record import Record
from pinn_cli.system.parameters import Parameter

DUFFING = ("c_1", "c_2", "k_1", "k_2", "kappa_1", "kappa_2")
LABELS: dict[str, object] = {
    "case": "pe", "estimator": "pinn", "scheme": "bayesian", "ndof": 2, "nonlinearity": "duffing",
    "model_error": "none", "snr_db": 20.0, "seed": 0,
}  # fmt: skip
_VALUES = {"c": (1.0, 0.03), "k": (15.0, 0.065), "kappa": (100.0, 0.7)}
CORRELATION = -0.9


def true_parameters(ndof: int = 2) -> dict[str, np.ndarray]:
    return {symbol: np.full(ndof, value) for symbol, (value, _) in _VALUES.items()}


def parameters_of(samples: PosteriorSamples) -> list[Parameter]:
    return [parameter_named(name) for name in samples.names]


def make_samples(
    names: Sequence[str] = DUFFING, chains: int = 4, draws: int = 200, forces: int = 1, **changes: object
) -> PosteriorSamples:
    generator = np.random.default_rng(0)
    means, deviations = np.array([_VALUES[name.rpartition("_")[0]] for name in names]).T
    standard = generator.standard_normal((chains, draws, len(names)))
    for i, name in enumerate(names):
        partner = name.replace("kappa", "k")
        if partner != name and partner in names:
            own = np.sqrt(1.0 - CORRELATION**2) * standard[..., i]
            standard[..., i] = CORRELATION * standard[..., list(names).index(partner)] + own
    fields = {
        "method": "marginal",
        "names": tuple(names),
        "draws": means + deviations * standard,
        "sigma_force": 0.13 + 0.002 * generator.standard_normal((chains, draws, forces)),
        "force_dofs": np.arange(1, forces + 1),
        "prior": np.abs(means * (1.0 + generator.standard_normal((500, len(names))))),
        "statistics": {
            "diverging": np.zeros((chains, draws), dtype=bool),
            "lp": -0.5 * (standard**2).sum(axis=-1),
            "n_steps": np.full((chains, draws), 7),
        },
        "warmup": 100,
        "seconds": np.full(chains, 1.5),
    }
    return PosteriorSamples(**(fields | changes))  # type: ignore[arg-type]


def make_record(dofs: int = 2, samples: int = 400) -> Record:
    time = np.linspace(0.0, 40.0, samples)
    force = np.sin(2.0 * np.pi * 0.5 * time)[:, None] + 0.13 * np.random.default_rng(1).standard_normal((samples, dofs))
    motion = np.zeros((samples, dofs))
    return Record(time, motion, motion, motion, force, np.zeros(dofs, dtype=bool))


def make_predictive(samples: PosteriorSamples, record: Record, every: int = 2) -> ForcePredictive:
    generator = np.random.default_rng(2)
    kept = np.arange(0, len(record.time), every)
    draws = np.arange(0, samples.draws.shape[1], 10)
    exact = np.sin(2.0 * np.pi * 0.5 * record.time[kept])[:, None]
    shape = (len(samples.draws), len(draws), len(kept), len(samples.force_dofs))
    return ForcePredictive(draws, kept, exact + 0.13 * generator.standard_normal(shape))


def make_diagnostics(samples: PosteriorSamples) -> pd.DataFrame:
    """Made up: the first parameter has the fewest effective draws."""
    pooled = samples.draws.reshape(-1, len(samples.names))
    effective = np.linspace(700.0, 3000.0, len(samples.names))
    lower, upper = np.quantile(pooled, (0.05, 0.95), axis=0)
    return pd.DataFrame(
        {
            "parameter": samples.names, "mean": pooled.mean(axis=0), "std": pooled.std(axis=0), "lower_90": lower,
            "upper_90": upper, "r_hat": 1.002, "ess_bulk": effective, "ess_tail": effective - 100.0,
            "mcse_mean": pooled.std(axis=0) / np.sqrt(effective),
        }
    )  # fmt: skip


def make_result(samples: PosteriorSamples, record: Record | None = None, *verdict: str) -> PosteriorResult:
    predictive = None if record is None else make_predictive(samples, record)
    return PosteriorResult(samples, make_diagnostics(samples), verdict, predictive)
