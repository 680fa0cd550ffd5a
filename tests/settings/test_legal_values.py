"""Values that a setting cannot have are told in one line, by the name that the setting has in a command."""

import math
import pickle
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from calls import refusal
from hydra.core.override_parser.overrides_parser import OverridesParser

from pinn_cli.baseline.kalman_smoother import KalmanSmoother
from pinn_cli.network.fourier import Fourier
from pinn_cli.network.mlp import Mlp
from pinn_cli.network.spline import Spline
from pinn_cli.posterior.laplace import Laplace
from pinn_cli.posterior.marginal import Marginal
from pinn_cli.scheme.sparse_recovery import SparseRecovery
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import (
    entries,
    finite_number,
    fraction,
    non_negative_number,
    one_of,
    positive_number,
    true_or_false,
    whole_number,
)
from pinn_cli.settings.override_syntax import with_folder_quoted
from pinn_cli.system.building import build_chain
from pinn_cli.system.connection import Duffing, Friction, Polynomial, PowerDamping
from pinn_cli.system.model_error import PerturbedModelError
from pinn_cli.training.gauss_newton import GaussNewton
from pinn_cli.training.gradient.adam import Adam
from pinn_cli.training.gradient.lbfgs import Lbfgs
from pinn_cli.validation.forecast import Forecast
from pinn_cli.validation.heldout import HeldOut


def choice(setting, value):
    return one_of(setting, value, ("a", "b"))


@pytest.mark.parametrize(
    ("check", "legal", "refused"),
    [
        (whole_number, [0, 3, np.int64(3)], [True, 3.0, "3", None, -1, math.inf, 2**63]),
        (finite_number, [-1, 0.5, np.float32(0.5)], [True, "3", None, math.nan, math.inf, 1e31, 10**400]),
        (positive_number, [1e-30, np.float32(0.5)], [0, -1, 1e-31, math.nan, True]),
        (non_negative_number, [0, 2.5], [-1, math.nan, "0"]),
        (fraction, [0.25], [0, 1.0, -0.5, 2, math.nan, True]),
        (true_or_false, [False, True], ["true", 1, None]),
        (choice, ["a"], ["c", None]),
    ],
)
def test_what_is_legal_and_what_is_named(check, legal, refused):
    for value in legal:
        assert check("x", value) == value
    for value in refused:
        with pytest.raises(InputError, match=r"^x=.*: must be"):
            check("x", value)


def test_a_text_has_no_entries():
    assert entries((1, 2)) == [1, 2]
    assert entries("12") == entries(None) == []


def chain(**settings):
    return build_chain(
        **{"ndof": 3, "nonlinearity": Duffing(), "m": 10.0, "c": 1.0, "k": 15.0, "kappa": 100.0} | settings
    )


# By class, and where its settings stand: one value at a time, as YAML.
IMPOSSIBLE = {
    (KalmanSmoother, "baseline"): "iterations: 0 | tolerance: 1.0 | process_noise: -1.0 | learn_spread: 'yes'",
    (Spline, "network"): "degree: 2 | knots_per_period: 0.0 | intervals: 3",
    (Fourier, "network"): "band_margin: 0.0 | period_margin: 0.5 | harmonics: 0",
    (Mlp, "network"): "depth: 0 | width: 2.5 | activation: relu | continuity: none | embedding: wavelet",
    (Laplace, "posterior"): "draws: 0",
    (Marginal, "posterior"): "chains: 0 | warmup: -1 | draws: 3 | draws: 1.0e+3 | target_accept: 1.0 | "
    "target_accept: high",
    (SparseRecovery, "scheme"): "parameter_uncertainty: -0.1 | parameter_uncertainty: little | "
    "acceleration_through: network | sensors: {acceleration: false}",
    (chain, "system"): "ndof: 0 | ndof: 2.5 | ndof: true | k: [15.0, 15.0] | k: '15' | k: [15.0, null, 15.0] | "
    "k: [15.0, .nan, 15.0] | k: -15.0 | k: null | c: -1.0 | c: .inf | m: 0.0 | m: [1.0, -1.0, 1.0] | kappa: .nan | "
    "kappa: [1.0, 1.0, 1.0, 1.0] | mu: 0.75",
    (PowerDamping, "system.nonlinearity"): "exponent: 0.5 | exponent: 0 | exponent: -1.0 | exponent: .nan | "
    "exponent: .inf | exponent: '2' | exponent: true | exponent: null",
    (Polynomial, "system.nonlinearity"): "orders: [] | orders: [1] | orders: [8] | orders: [2, 2] | orders: [2.0] | "
    "orders: 3 | orders: '23' | orders: [true]",
    (Friction, "system.nonlinearity"): "speed: 0.0 | speed: -1.0 | speed: .inf | speed: slow",
    (PerturbedModelError, "model_error"): "seed: -1 | seed_stride: '1' | draws: gaussian | bounds: [0.1, 0.05] | "
    "bounds: [0.1, 1.0]",
    (GaussNewton, "training"): "iterations: 0 | tolerance: 0.0 | tolerance: 1.5 | learn_spread: 'yes' | "
    "collocation_points: 1 | most_residuals: 3",
    (Adam, "training"): "iterations: 0 | stages: 0 | physics_growth: 0.0 | learning_rate: -0.001 | "
    "parameter_learning_rate: .nan | betas: [0.9] | betas: [0.9, 1.0] | weight_decay: -1.0 | weights: evidence | "
    "weights: {data: 1.0} | weights: {physics: null} | weights: {unforced: -1.0} | collocation_points: 1 | "
    "dtype: float16 | history_every: 0",
    (Lbfgs, "training"): "memory: 0 | warm_up: -1 | tolerance: -1.0",
    (HeldOut, "validation"): "dofs: [0] | dofs: [] | dofs: two | dofs: [1.5]",
    (Forecast, "validation"): "share: 0 | share: 1 | share: half | blocks: 0",
}  # fmt: skip


@pytest.mark.parametrize(
    ("made", "place", "given"), [(*of, value) for of, values in IMPOSSIBLE.items() for value in values.split(" | ")]
)
def test_it_is_told_by_its_name(made, place, given):
    told = refusal(made, **yaml.safe_load(given))
    assert re.match(rf"{re.escape(place)}\.{given.partition(':')[0]}[.=].*: must be ", told)


@pytest.mark.parametrize("name", ["noise.snr_db=50,seed=3", "system=linear", "it's=odd,too"])
def test_a_folder_of_a_sweep_is_a_model_as_it_stands(tmp_path: Path, name: str) -> None:
    folder = tmp_path / name
    folder.mkdir()
    (parsed,) = OverridesParser.create().parse_overrides([with_folder_quoted(f"model={folder}")])
    value = parsed.value()
    assert not parsed.is_sweep_override()
    assert str(getattr(value, "text", value)) == str(folder)


@pytest.mark.parametrize("override", ["model=missing=1,b", "seed=0,1", "model='a=1'", "model=plain"])
def test_other_values_stay_as_they_are(override: str) -> None:
    assert with_folder_quoted(override) == override


def test_an_error_crosses_processes_and_is_cut():
    error = InputError("system.ndof", 0, ">= 1", "a chain has a mass")
    assert str(pickle.loads(pickle.dumps(error))) == "system.ndof=0: must be >= 1; a chain has a mass"
    told = str(InputError("case", "a" * 6000, "a name", "b" * 6000))
    assert told.startswith(f"case={'a' * 500}... (6000 characters): must be a name; bbb")
    assert len(told) < 1100
