"""`hydra/sweeper=search`: trials, one after the other or side by side, each drawn by Optuna from those before it.

A trial is put into the study once it has ended. Its draw depends on the seed, its number and the trials before its
batch, and on nothing that a kill could interrupt: a search that was killed draws the trial that was under way once
more, finds its job's directory, and goes on as if it had never been stopped.
"""

from __future__ import annotations

import hashlib
import math
import sys
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import optuna
from hydra.core.plugins import Plugins
from hydra.core.utils import JobReturn
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler, RandomSampler, TPESampler
from optuna.study import Study
from optuna.trial import FrozenTrial, TrialState, create_trial

from pinn_cli.runs.identity import is_left_out
from pinn_cli.runs.reading import printable
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import one_of, whole_number
from pinn_cli.settings.override_syntax import setting_of
from pinn_cli.sweep.callback import begin_sweep
from pinn_cli.sweep.failure import Failure
from pinn_cli.sweep.jobs import job_directories
from pinn_cli.sweep.search_report import report_search
from pinn_cli.sweep.search_space import read_space, within
from pinn_cli.sweep.search_trials import OVERRIDES, create_study, load_study, overrides_of

METHODS = ("tpe", "random")
NO_VALIDATION, EVIDENCE = "NoValidation", "EvidenceScore"
# What the evidence can compare: the model of the chain and the search for its weights, under one network and record.
COMPARABLE = (
    "system", "scheme.parameter_uncertainty", "scheme.unknown", "scheme.initial", "scheme.prior_width",
    "training.learn_spread", "training.iterations", "training.tolerance",
)  # fmt: skip


class Search:
    """A search for the settings with the least validation score.

    The first trial has the settings as they are configured, where the search may choose them: nothing that it finds is
    worse than what a run without it has.

    Args:
        hydra_context: Of the sweep, as are the next two.
        task_function: What a job runs; it returns its score, None where there is none.
        config: With its `hydra` node.
        sampler: `method` (``tpe``, the tree-structured Parzen estimator of Bergstra et al. 2011, or ``random``), `seed`
            of all draws, and `startup`, the random trials before the estimator is trusted.
        n_trials: In all, those of an earlier start included.
        n_jobs: Trials at a time.
        params: What settings may be, besides those on the command line.

    Raises:
        InputError: A setting outside its range, nothing that scores the trials, or another search in the directory.
    """

    def __init__(
        self,
        hydra_context: HydraContext,
        task_function: TaskFunction,
        config: DictConfig,
        sampler: Mapping[str, Any],
        n_trials: int = 30,
        n_jobs: int = 1,
        params: Mapping[str, str] | None = None,
    ) -> None:
        self.config, self.directory = config, Path(config.hydra.sweep.dir)
        self.method = one_of("hydra.sweeper.sampler.method", sampler["method"], METHODS)
        self.seed = whole_number("hydra.sweeper.sampler.seed", sampler["seed"])
        self.startup = whole_number("hydra.sweeper.sampler.startup", sampler["startup"], least=1)
        self.n_trials = whole_number("hydra.sweeper.n_trials", n_trials)
        self.n_jobs = whole_number("hydra.sweeper.n_jobs", n_jobs, least=1)
        self.params = [f"{name}={choices}" for name, choices in (params or {}).items()]
        self.validation = str(OmegaConf.select(config, "validation._target_")).rpartition(".")[2]
        if self.validation == NO_VALIDATION:
            raise InputError(
                "validation", "none", "heldout, forecast or evidence in a search", "it is the score that is minimised"
            )
        typed = [str(override) for override in config.hydra.overrides.task]
        self.overrides = sorted([*(o for o in typed if not is_left_out(setting_of(o))), *self.params])
        elsewhere = not str(config.hydra.launcher.get("_target_")).endswith("SerialLauncher")
        if elsewhere and self.n_jobs == 1:
            print("one trial at a time: hydra.sweeper.n_jobs=2 has two at once", file=sys.stderr)
        self.launcher = Plugins.instance().instantiate_launcher(
            hydra_context=hydra_context, task_function=task_function, config=config
        )

    def run(self, arguments: Sequence[str]) -> None:
        """Make the trials that are missing, write the report and print it.

        Args:
            arguments: Overrides on the command line.

        Raises:
            InputError: The score cannot compare what is searched, or no trial has one.
        """
        space, fixed = read_space([*self.params, *arguments])
        self._check_comparable(space)
        begin_sweep(self.config)
        self._check_study()
        study = create_study(self.directory)
        study.set_user_attr(OVERRIDES, self.overrides)
        while (ended := len(study.get_trials(deepcopy=False))) < self.n_trials:
            first = ended - ended % self.n_jobs  # of the batch, of which a kill may have left the rest to be made
            before = study.get_trials(deepcopy=False)[:first]
            began, numbers = datetime.now(), range(ended, min(first + self.n_jobs, self.n_trials))
            drawn = [create_trial(state=TrialState.FAIL, params=self._draw(number, before, space),
                                  distributions=space, user_attrs=fixed) for number in numbers]  # fmt: skip
            returned = self.launcher.launch([overrides_of(trial) for trial in drawn], initial_job_idx=ended)
            for trial, result in zip(drawn, returned, strict=True):
                score = _score(result)
                if score is not None:
                    trial.state, trial.value = TrialState.COMPLETE, score
                trial.datetime_start, trial.datetime_complete = began, datetime.now()
                study.add_trial(trial)
                self._announce(study, score)
        scored = any(trial.state == TrialState.COMPLETE for trial in study.get_trials(deepcopy=False))
        if self.n_trials and not scored:
            allowed = "given settings under which a trial ends with a score"
            jobs = map(Failure.read, job_directories(self.directory))
            reason = next((f": {failure.reason}" for failure in jobs if failure is not None), "")
            raise InputError("hydra/sweeper", "search", allowed, f"every trial failed{reason}")
        print(printable(report_search(self.directory)))

    def _check_study(self) -> None:
        study = load_study(self.directory)
        known = self.overrides if study is None else study.user_attrs.get(OVERRIDES, self.overrides)
        if known != self.overrides:
            changed = ", ".join(sorted(set(known) ^ set(self.overrides)))
            allowed = "another directory: there is a search with other settings in this one"
            raise InputError("hydra.sweep.dir", "(as given)", allowed, f"they differ in {changed}")

    def _check_comparable(self, space: Mapping[str, BaseDistribution]) -> None:
        for name in space if self.validation == EVIDENCE else ():
            if not name.startswith(COMPARABLE):
                hint = f"{name} changes what the evidence is relative to; validation=heldout compares it"
                raise InputError("validation", "evidence", f"used in searches over {', '.join(COMPARABLE)}", hint)

    def _draw(
        self, number: int, before: Sequence[FrozenTrial], space: Mapping[str, BaseDistribution]
    ) -> dict[str, Any]:
        """The settings of a trial, drawn in memory from those before it, with a seed of its own."""
        seed = drawing_seed(self.seed, number)
        tpe = self.method == "tpe"
        sampler: BaseSampler = TPESampler(n_startup_trials=self.startup, seed=seed) if tpe else RandomSampler(seed=seed)
        study = optuna.create_study(sampler=sampler)
        study.add_trials(before)
        if number == 0:
            configured = {name: within(space[name], _configured(self.config, name)) for name in space}
            study.enqueue_trial({name: value for name, value in configured.items() if value is not None})
        return study.ask(dict(space)).params

    def _announce(self, study: Study, score: float | None) -> None:
        """Tell of the trial that has ended in one line."""
        trials = study.get_trials(deepcopy=False)
        scores = [trial.value for trial in trials if trial.state == TrialState.COMPLETE and trial.value is not None]
        ended = "failed" if score is None else f"score {score:.5g}"
        best = f"  best {min(scores):.5g}" if scores else ""
        print(f"{len(trials)} of {self.n_trials}  {ended}{best}", file=sys.stderr)


def _score(result: JobReturn) -> float | None:
    """What a job returned; None where it has no score, or failed."""
    try:
        score = float(result.return_value)
    except Exception:
        return None
    return score if math.isfinite(score) else None


def _configured(config: DictConfig, name: str) -> Any:
    """What a setting, or a config group, is without the search; None where that is no single value."""
    value = OmegaConf.select(config, name)
    if isinstance(value, DictConfig):
        return OmegaConf.select(config, "hydra.runtime.choices").get(name)
    return None if OmegaConf.is_config(value) else value


def drawing_seed(seed: int, number: int) -> int:
    """Of the random numbers of one trial, on every machine the same; below 2^32."""
    return int.from_bytes(hashlib.sha256(f"{seed}/{number}".encode()).digest()[:4], "little")
