"""The sampler of a search: Optuna's, seeded so that a search that was killed goes on as if it never had been."""

from __future__ import annotations

import hashlib
import logging
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, CategoricalDistribution
from optuna.samplers import BaseSampler, RandomSampler, TPESampler
from optuna.study import Study
from optuna.trial import FrozenTrial, TrialState

from pinn_cli.runs.identity import is_left_out
from pinn_cli.search.study import MADE_OF, load
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import one_of, whole_number
from pinn_cli.settings.override_syntax import setting_of

METHODS = ("tpe", "random")
NO_VALIDATION, EVIDENCE = "NoValidation", "EvidenceScore"
# What the evidence can compare: the model of the chain and the search for its weights, under one network and record.
COMPARABLE = (
    "system", "scheme.parameter_uncertainty", "scheme.unknown", "scheme.initial", "scheme.prior_width",
    "training.learn_spread", "training.iterations", "training.tolerance",
)  # fmt: skip


class SearchSampler(BaseSampler):
    """A tree-structured Parzen estimator (Bergstra et al. 2011), or random draws, with a seed for every draw.

    A sampler with one stream of random numbers starts that stream again when a search is started again, and repeats its
    first draws. Here each draw depends on the seed, the trial's number, the setting's name and the trials before. The
    first trial has the settings as they are configured, where the search may choose them: nothing that it finds is
    worse than what a run without it has.

    Args:
        method: ``tpe`` or ``random``.
        seed: Of all draws.
        startup: Random trials before the estimator is trusted.
        validation: Class that scores the trials (``validation._target_``).
        overrides: Of the search, as typed; another search must not go on with its trials.
        params: Of the sweeper, likewise.
        directory: Of the sweep, where those of an earlier start may lie.
        configured: Value of every searched setting without the search.
        trials: How many are asked for, for the line that tells of each.

    Raises:
        InputError: A setting outside its range, or nothing that scores the trials.
    """

    def __init__(
        self,
        method: str = "tpe",
        seed: int = 0,
        startup: int = 10,
        validation: str = "",
        overrides: Sequence[str] = (),
        params: Mapping[str, str] | None = None,
        directory: str | None = None,
        configured: Mapping[str, Any] | None = None,
        trials: int | None = None,
    ) -> None:
        self.method = one_of("hydra.sweeper.sampler.method", method, METHODS)
        self.seed = whole_number("hydra.sweeper.sampler.seed", seed)
        self.startup = whole_number("hydra.sweeper.sampler.startup", startup, least=1)
        self.validation = validation.rpartition(".")[2]
        if self.validation == NO_VALIDATION:
            raise InputError(
                "validation", "none", "heldout, forecast or evidence in a search", "it is the score that is minimised"
            )
        kept = [override for override in overrides if not is_left_out(setting_of(override))]
        self.made_of = sorted([*kept, *(f"{name}={choice}" for name, choice in (params or {}).items())])
        self.configured, self.trials = dict(configured or {}), trials
        optuna.logging.set_verbosity(logging.WARNING)
        self._check_same_search(None if directory is None else load(Path(directory)))

    def _check_same_search(self, study: Study | None) -> None:
        known = None if study is None else study.user_attrs.get(MADE_OF)
        if known is not None and known != self.made_of:
            changed = ", ".join(sorted(set(known) ^ set(self.made_of)))
            allowed = "another directory: there is a search with other settings in this one"
            raise InputError("hydra.sweep.dir", "(as given)", allowed, f"they differ in {changed}")

    def infer_relative_search_space(self, study: Study, trial: FrozenTrial) -> dict[str, BaseDistribution]:
        """Settings are drawn one by one; the first trial notes which search it is of."""
        if MADE_OF not in study.user_attrs:
            study.set_user_attr(MADE_OF, self.made_of)
        return {}

    def sample_relative(
        self, study: Study, trial: FrozenTrial, search_space: Mapping[str, BaseDistribution]
    ) -> dict[str, Any]:
        """Nothing is drawn jointly."""
        return {}

    def sample_independent(
        self, study: Study, trial: FrozenTrial, param_name: str, param_distribution: BaseDistribution
    ) -> Any:
        """One setting of one trial."""
        if self.validation == EVIDENCE and not param_name.startswith(COMPARABLE):
            hint = f"{param_name} changes what the evidence is relative to; validation=heldout compares it"
            raise InputError("validation", "evidence", f"used in searches over {', '.join(COMPARABLE)}", hint)
        if trial.number == 0:
            value = within(param_distribution, self.configured.get(param_name))
            if value is not None:
                return value
        seed = drawing_seed(self.seed, trial.number, param_name)
        return self._sampler(seed).sample_independent(study, trial, param_name, param_distribution)

    def after_trial(self, study: Study, trial: FrozenTrial, state: TrialState, values: Sequence[float] | None) -> None:
        """Tell of it in one line."""
        scores = [t.value for t in study.get_trials(deepcopy=False) if t.state == TrialState.COMPLETE]
        known = [score for score in (*scores, *(values or ())) if score is not None]
        told = f"score {values[0]:.5g}" if values else "failed"
        best = f"  best {min(known):.5g}" if known else ""
        print(f"{trial.number + 1} of {self.trials or '?'}  {told}{best}", file=sys.stderr)

    def _sampler(self, seed: int) -> BaseSampler:
        if self.method == "random":
            return RandomSampler(seed=seed)
        return TPESampler(seed=seed, n_startup_trials=self.startup, warn_independent_sampling=False)


def within(distribution: BaseDistribution, value: Any) -> Any:
    """The value as the distribution has it; None where it cannot be drawn from it."""
    if isinstance(distribution, CategoricalDistribution):
        alike = (c for c in distribution.choices if c == value and isinstance(c, bool) == isinstance(value, bool))
        return next(alike, None)
    if isinstance(value, bool) or not isinstance(value, int | float) or not distribution._contains(float(value)):
        return None
    drawn = distribution.to_external_repr(float(value))
    return drawn if drawn == value else None


def drawing_seed(seed: int, number: int, name: str) -> int:
    """Of the random numbers of one setting in one trial, on every machine the same; below 2^32."""
    digest = hashlib.sha256(f"{seed}/{number}/{name}".encode()).digest()
    return int(np.frombuffer(digest[:4], dtype="<u4")[0])
