"""The typed, validated configuration of a run: every object that it needs, built before any work is done.

Rules about one object's values stand in that object's constructor; the rules here are those about the run as a whole.
Nothing slow is imported above: `pinn-run --help` reads this module too.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from pinn_cli.cli.records import numbered
from pinn_cli.cli.source import Source, check_use, chosen_model, modes_sought, read_source, read_structure
from pinn_cli.runs.identity import Identity
from pinn_cli.runs.process import prepare_process
from pinn_cli.runs.resume import NEVER, RESUME_ALLOWED
from pinn_cli.settings.errors import InputError, suggestion
from pinn_cli.settings.instantiation import build, check_classes, construct
from pinn_cli.settings.legal_values import positive_number, true_or_false, whole_number

if TYPE_CHECKING:
    from pinn_cli.model.knowledge import Model
    from pinn_cli.network.network import NetworkDesign
    from pinn_cli.posterior.posterior import Posterior
    from pinn_cli.record.record import Record
    from pinn_cli.report.export import Export
    from pinn_cli.report.results import RunDescription
    from pinn_cli.scheme.scheme import Scheme
    from pinn_cli.sweep.tracking.tracking import Tracking
    from pinn_cli.system.building import ModesSought
    from pinn_cli.system.model_error import ModelError
    from pinn_cli.system.structure import Structure
    from pinn_cli.training.estimator import Estimator, TrainedNetwork, Training
    from pinn_cli.validation.validation import Validation

VALUES = ("case", "seed", "device", "threads", "resume", "figures", "strict", "model")
NODES = (
    "system", "excitation", "simulation", "noise", "model_error", "data", "scheme", "network", "training", "posterior",
    "validation", "baseline", "tracking", "report", "follow",
)  # fmt: skip

# Where the file of a training, a user's own perhaps, does not say.
CHECKPOINT_EVERY_S = 30.0

# More than any machine has cores; libraries set memory aside for each.
MOST_THREADS = 1024


@dataclass(frozen=True)
class RunConfig:
    """Everything that a run is made of, checked.

    Attributes:
        case: Name of the case, a folder's name.
        seed: Of everything random that has no seed of its own.
        device: Where networks whose weights are all trained live: cpu, cuda, cuda:1.
        threads: Of torch and of the linear algebra.
        structure: The structure as configured, before model error; NaN where a measured one has no value.
        model_error: What differs between the true and the prescribed chain.
        source: Where the record comes from.
        scheme: What is observed and what is unknown.
        network: What stands for the response as a function of time.
        training: How the problem is solved.
        posterior: How the distribution of the parameters is found, with scheme=bayesian.
        validation: How the estimate is scored without the truth.
        baseline: What the network is compared with; None: nothing.
        tracking: What else keeps a record of the run; None: nothing.
        identity: Which run this is, for its checkpoints and results.
        resume: Whether to go on with what lies in the run's directory: None, `auto`, or that directory.
        figures: Whether they are drawn; None: unless the run is a job of a sweep.
        checkpoint_every_s: Seconds from checkpoint to checkpoint; None: only when the run is asked to stop.
        exports: Formats in which the response is written beside ``response.nc``.
        between: From when to when figures show histories, s, to be compared with the record; None: they choose.
        strict: Whether a verdict other than sound ends the run with exit status 4.
        model: The finished run whose structure and parameters are taken; None: there is none.
        modes: Those that the record is asked for; None: the structure has its own.
    """

    case: str
    seed: int
    device: str
    threads: int
    structure: Structure
    model_error: ModelError
    source: Source
    scheme: Scheme
    network: NetworkDesign
    training: Training
    posterior: Posterior
    validation: Validation
    baseline: Estimator | None
    tracking: Tracking | None
    identity: Identity
    resume: str | None
    figures: bool | None
    checkpoint_every_s: float | None
    strict: bool
    exports: tuple[Export, ...]
    between: Sequence[float] | None
    model: Model | None = None
    modes: ModesSought | None = None

    @classmethod
    def read(cls, config: DictConfig, base: Path | None = None, follows: bool = False) -> RunConfig:
        """Check a composed configuration and build what it describes; threads are limited from here on.

        Args:
            config: As composed by Hydra, without its `hydra` node.
            base: The folder that relative paths of data start from; None: the current one.
            follows: Whether its record may still grow.

        Raises:
            InputError: At the first setting that no run can use.
        """
        config = resolved(config)
        _check_names(config)
        check_classes(config)
        identity, resume, device = Identity.of(config, base, grows=follows), config.resume, config.device
        if resume is not None and not isinstance(resume, str):
            raise InputError("resume", resume, RESUME_ALLOWED)
        # Taken out of the training's settings: it is the run that keeps checkpoints, whatever the training.
        every_s = config.training.pop("checkpoint_every_s", CHECKPOINT_EVERY_S)
        every_s = None if every_s is None else positive_number("training.checkpoint_every_s", every_s)
        is_name = isinstance(config.case, str | int | float) and not isinstance(config.case, bool)
        if not is_name or not re.fullmatch(r"[\w+-][\w.+-]*", str(config.case)):
            raise InputError("case", config.case, "a folder's name: letters, digits, and any of . _ + -")
        seed = whole_number("seed", config.seed, most=2**32 - 1)
        if not isinstance(device, str) or not re.fullmatch(r"cpu|cuda(:\d+)?", device):
            raise InputError("device", device, "cpu, cuda or cuda:N")
        threads = whole_number("threads", config.threads, least=1, most=MOST_THREADS)
        prepare_process(threads)
        _check_available(device)
        model_error = build(config.model_error, "model_error")
        model = chosen_model(config, model_error, base)
        structure = read_structure(config, base, model)
        config = numbered(config, structure.labels)
        scheme = build(config.scheme, "scheme", model=model)
        source = read_source(config, structure, model_error, scheme, seed, base, follows)
        names = ("network", "training", "posterior", "validation")
        from pinn_cli.report.export import report_settings

        exports, between = construct(report_settings, config.report, "report")
        estimation = {name: build(config[name], name, model=model) for name in names}
        check_use(model, scheme, estimation["validation"], config.model)
        if config.figures is not None:
            true_or_false("figures", config.figures)
        return cls(
            str(config.case), seed, device, threads, structure, model_error, source, scheme, **estimation,
            baseline=build(config.baseline, "baseline") if config.baseline else None,
            tracking=build(config.tracking, "tracking", base=base) if config.tracking else None,
            identity=identity,
            resume=None if resume == NEVER else resume,
            figures=config.figures,
            checkpoint_every_s=every_s,
            strict=true_or_false("strict", config.strict),
            exports=exports,
            between=between,
            model=model,
            modes=modes_sought(config, scheme, estimation["validation"]),
        )  # fmt: skip

    def observe(self, record: Record) -> Record:
        """What the estimator may see: the scheme's choice of simulated sensors, or all of a measured record."""
        return self.scheme.observe(record) if self.source.simulated else record

    @property
    def estimator(self) -> TrainedNetwork:
        """The network, and how it is trained."""
        from pinn_cli.training.estimator import TrainedNetwork

        if self.scheme.predicts and self.model is not None:
            from pinn_cli.scheme.predict import Predict
            from pinn_cli.training.prediction import Predictor

            assert isinstance(self.scheme, Predict)
            return Predictor(self.training, self.network, self.model, self.scheme)
        if not self.scheme.looks_for_changes:
            return TrainedNetwork(self.training, self.network)
        from pinn_cli.training.changes import UpdatedNetwork

        return UpdatedNetwork(self.training, self.network)

    @property
    def description(self) -> RunDescription:
        """What the report says of the run itself."""
        from pinn_cli.report.results import RunDescription

        labels = {
            "case": self.case,
            "scheme": self.scheme.name,
            "ndof": self.structure.ndof,
            "nonlinearity": self.structure.nonlinearity_name,
            "model_error": self.model_error.name if self.source.simulated else None,
            "snr_db": self.source.snr_db,
            "seed": self.seed,
        }
        return RunDescription(
            self.case, self.seed, self.threads, self.identity.configuration, labels,
            self.source.simulated, self.validation.name, "none" if self.baseline is None else self.baseline.name,
        )  # fmt: skip


def resolved(config: DictConfig) -> DictConfig:
    """The same with every interpolation replaced by its value."""
    for setting in OmegaConf.missing_keys(config):
        raise InputError(setting, "(missing)", "given", f"add {setting}=... to the command")
    try:
        container = OmegaConf.to_container(config, resolve=True)
    except OmegaConfBaseException as error:
        setting = str(getattr(error, "full_key", None) or "configuration")
        raise InputError(setting, "${...}", "resolvable", str(error).partition("\n")[0]) from error
    return OmegaConf.create(container)  # type: ignore[return-value]


def _check_names(config: DictConfig) -> None:
    """A setting that nothing reads is a slip: in a config file Hydra lets it pass."""
    names = (*VALUES, *NODES)
    for name in config:
        if name not in names:
            hint = suggestion(str(name), names)
            raise InputError(str(name), config[name], f"one of the settings {', '.join(names)}", hint)
    for name in names:
        if name not in config:
            raise InputError(name, "(missing)", "given", "the main config has it: was it deleted with ~?")
    for name in NODES:
        if not isinstance(config[name], DictConfig):
            raise InputError(name, config[name], f"a group of settings ({name}.something=...)")


def _check_available(device: str) -> None:
    if device == "cpu":
        return
    import torch

    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if int(device.partition(":")[2] or 0) >= count:
        hint = "no CUDA device is visible to torch" if count == 0 else f"torch sees {count}, counted from 0"
        raise InputError("device", device, "cpu or a CUDA device that is there", hint)
