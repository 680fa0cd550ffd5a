"""The typed, validated configuration of a run: every object that it needs, built before any work is done.

Rules about one object's values stand in that object's constructor; the rules here are those about the run as a whole.
Nothing slow is imported above: `pinn-run --help` reads this module too.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from pinn_cli.cli.dof_names import in_names, named, numbered
from pinn_cli.cli.records import data_of_records, of_record
from pinn_cli.runs.identity import Identity
from pinn_cli.runs.memory import keep_freed_memory, leave_without_collecting
from pinn_cli.runs.resume import ALLOWED, NEVER
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.instantiation import build, check_classes, construct
from pinn_cli.settings.legal_values import positive_number, whole_number
from pinn_cli.settings.suggestion import suggestion

if TYPE_CHECKING:
    from pinn_cli.network.base import NetworkDesign
    from pinn_cli.posterior.base import Posterior
    from pinn_cli.record.record import Measurements, Record
    from pinn_cli.record.validation_data import ValidationData, ValidationRecord
    from pinn_cli.report.export.base import Export
    from pinn_cli.report.results import RunDescription
    from pinn_cli.scheme.base import Scheme
    from pinn_cli.system.model_error import ModelError
    from pinn_cli.system.structure import Structure
    from pinn_cli.tracking.base import Tracking
    from pinn_cli.training.base import Estimator, TrainedNetwork, Training
    from pinn_cli.validation.base import Validation

VALUES = ("case", "seed", "device", "threads", "resume", "figures", "strict")
NODES = (
    "system",
    "excitation",
    "simulation",
    "noise",
    "model_error",
    "data",
    "scheme",
    "network",
    "training",
    "posterior",
    "validation",
    "baseline",
    "tracking",
    "report",
)

SIMULATED = "pinn_cli.record.simulated.Simulated"

# Where the file of a training, a user's own perhaps, does not say.
CHECKPOINT_EVERY_S = 30.0

# More than any machine has cores; libraries set memory aside for each.
MOST_THREADS = 1024

# Read by the linear algebra libraries when they are first loaded, which is after this module.
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Source:
    """Where the record comes from.

    Attributes:
        measure: From the true chain to the record, with every sensor that exists, and the truth as far as it is known.
            Of several records of one structure that of the first.
        simulated: Whether every sensor exists, so that the scheme chooses among them.
        snr_db: Of a simulated record, dB; None without noise and for a measured record.
        validate: From the true chain and what the estimator sees to the data that the identified system is tried on;
            None: there are none.
        further: Of the other records, where several are solved together.
    """

    measure: Callable[[Structure], Measurements]
    simulated: bool
    snr_db: float | None
    validate: Callable[[Structure, Record], ValidationRecord] | None = None
    further: tuple[Callable[[Structure], Measurements], ...] = ()

    def measurements(self, true: Structure) -> list[Measurements]:
        """Those of every record."""
        each = (self.measure, *self.further)
        found = []
        for number, measure in enumerate(each, start=1):
            with of_record(number, len(each)):
                found.append(measure(true))
        return found


@dataclass(frozen=True)
class RunConfig:
    """Everything that a run is made of, checked.

    Attributes:
        case: Name of the case, a folder's name.
        seed: Of everything random that has no seed of its own.
        device: Where networks and residuals live: cpu, cuda, cuda:1.
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
        tracking: What else keeps a record of the run.
        identity: Which run this is, for its checkpoints and results.
        resume: Whether to go on with what lies in the run's directory: None, `auto`, or that directory.
        figures: Whether they are drawn; None: unless the run is a job of a sweep.
        checkpoint_every_s: Seconds from checkpoint to checkpoint; None: only when the run is asked to stop.
        exports: Formats in which the response is written beside ``response.nc``.
        strict: Whether a verdict other than sound ends the run with exit status 4.
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
    tracking: Tracking
    identity: Identity
    resume: str | None
    figures: bool | None
    checkpoint_every_s: float | None
    strict: bool
    exports: tuple[Export, ...]

    @classmethod
    def read(cls, config: DictConfig, base: Path | None = None) -> RunConfig:
        """Check a composed configuration and build what it describes; threads are limited from here on.

        Args:
            config: As composed by Hydra, without its `hydra` node.
            base: The folder that relative paths of data start from; None: the current one.

        Raises:
            InputError: At the first setting that no run can use.
        """
        config = resolved(config)
        _check_names(config)
        check_classes(config)
        identity, resume, checkpoint_every_s = Identity.of(config, base), _resume(config), _checkpoint_every_s(config)
        case, seed, device, threads = _case(config), _seed(config), _device(config), _threads(config)
        keep_freed_memory()
        leave_without_collecting()
        _limit_threads(threads)
        _check_available(device)
        model_error = build(config.model_error, "model_error")
        structure = read_structure(config, base)
        config = numbered(config, structure.labels)
        source = _source(config, structure, model_error, seed, base)
        names = ("scheme", "network", "training", "posterior", "validation")
        estimation = {name: build(config[name], name) for name in names}
        estimation["baseline"] = build(config.baseline, "baseline") if config.baseline else None
        estimation["tracking"] = build(config.tracking, "tracking", base=base)
        again: dict[str, Any] = {"identity": identity, "resume": resume, "checkpoint_every_s": checkpoint_every_s}
        again |= {"figures": _figures(config), "strict": _strict(config)}
        again["exports"] = _exports(config)
        return cls(case, seed, device, threads, structure, model_error, source, **estimation, **again)

    def observe(self, record: Record) -> Record:
        """What the estimator may see: the scheme's choice of simulated sensors, or all of a measured record."""
        return self.scheme.observe(record) if self.source.simulated else record

    @property
    def estimator(self) -> TrainedNetwork:
        """The network, and how it is trained."""
        from pinn_cli.training.base import TrainedNetwork

        return TrainedNetwork(self.training, self.network)

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
            self.case, self.seed, self.device, self.threads, self.identity.configuration, labels,
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
    known = (*VALUES, *NODES)
    for name in map(str, config):
        if name not in known:
            raise InputError(name, config[name], f"one of the settings {', '.join(known)}", suggestion(name, known))
    for name in known:
        if name not in config:
            raise InputError(name, "(missing)", "given", "the main config has it: was it deleted with ~?")
    for name in NODES:
        if not isinstance(config[name], DictConfig):
            raise InputError(name, config[name], f"a group of settings ({name}.something=...)")


def _case(config: DictConfig) -> str:
    is_name = isinstance(config.case, str | int | float) and not isinstance(config.case, bool)
    if not is_name or not re.fullmatch(r"[\w+-][\w.+-]*", str(config.case)):
        raise InputError("case", config.case, "a folder's name: letters, digits, and any of . _ + -")
    return str(config.case)


def _seed(config: DictConfig) -> int:
    return whole_number("seed", config.seed, most=2**32 - 1)


def _threads(config: DictConfig) -> int:
    return whole_number("threads", config.threads, least=1, most=MOST_THREADS)


def _device(config: DictConfig) -> str:
    if not isinstance(config.device, str) or not re.fullmatch(r"cpu|cuda(:\d+)?", config.device):
        raise InputError("device", config.device, "cpu, cuda or cuda:N")
    return config.device


def _resume(config: DictConfig) -> str | None:
    if config.resume is not None and not isinstance(config.resume, str):
        raise InputError("resume", config.resume, ALLOWED)
    return None if config.resume == NEVER else config.resume


def _figures(config: DictConfig) -> bool | None:
    if config.figures is not None and not isinstance(config.figures, bool):
        raise InputError("figures", config.figures, "null, true or false")
    return config.figures


def _strict(config: DictConfig) -> bool:
    if not isinstance(config.strict, bool):
        raise InputError("strict", config.strict, "true or false")
    return config.strict


def _exports(config: DictConfig) -> tuple[Export, ...]:
    from pinn_cli.report.export.formats import exports_of

    def read(export: list[str]) -> tuple[Export, ...]:
        return exports_of(export)

    return construct(read, config.report, "report")


def _checkpoint_every_s(config: DictConfig) -> float | None:
    """Taken out of the training's settings: it is the run that keeps checkpoints, whatever the training."""
    given = config.training.pop("checkpoint_every_s", CHECKPOINT_EVERY_S)
    return None if given is None else positive_number("training.checkpoint_every_s", given)


def _limit_threads(threads: int) -> None:
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, str(threads)))
    import torch

    torch.set_num_threads(threads)


def _check_available(device: str) -> None:
    if device == "cpu":
        return
    import torch

    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if int(device.partition(":")[2] or 0) >= count:
        hint = "no CUDA device is visible to torch" if count == 0 else f"torch sees {count}, counted from 0"
        raise InputError("device", device, "cpu or a CUDA device that is there", hint)


def read_structure(config: DictConfig, base: Path | None) -> Structure:
    """The structure; of a measured one values may be missing, which the scheme then has to be asked for."""
    from pinn_cli.system.building import build_chain, build_partial_chain
    from pinn_cli.system.topology import build_partial_structure, build_structure

    if config.system.get("kind") == "matrices":
        return _finite_elements(config, base)
    named = config.system.get("kind") == "structure"
    whole, partial = (build_structure, build_partial_structure) if named else (build_chain, build_partial_chain)
    return construct(whole if _is_simulated(config) else partial, config.system, "system")


def _finite_elements(config: DictConfig, base: Path | None) -> Structure:
    """A reduced model, with the static responses of the DOFs that carry a force."""
    from pinn_cli.system.finite_elements import build_finite_elements
    from pinn_cli.system.topology import whole

    if _is_simulated(config):
        forces = config.excitation.get("dofs")
        loaded = list(forces) if OmegaConf.is_config(forces) else []
    else:
        loaded = list(dict.fromkeys(dof for node in data_of_records(config.data) for dof in _loaded(node)))
    structure = construct(build_finite_elements, config.system, "system", base=base, loaded=loaded)
    return whole(structure) if _is_simulated(config) else structure


def _loaded(data: DictConfig) -> list[Any]:
    """DOFs that carry a force in one measured record."""
    from pinn_cli.system.quantities import FORCE

    forces, channels = data.get("force"), data.get("channels")
    loaded = list(forces) if OmegaConf.is_config(forces) else []
    for channel in channels.values() if OmegaConf.is_dict(channels) else ():
        if OmegaConf.is_dict(channel) and channel.get("sensor") == FORCE and channel.get("dof") is not None:
            loaded.append(channel.dof)
    return loaded


def _is_simulated(config: DictConfig) -> bool:
    simulated, kind = config.data.get("_target_") == SIMULATED, config.data.get("kind")
    if simulated != (kind == "simulated"):
        raise InputError("data.kind", kind, "left as the file of the option has it", "choose by data=...")
    return simulated


def _measured(config: DictConfig, structure: Structure, base: Path | None) -> list[Any]:
    """What measures every record of `data`."""
    nodes = data_of_records(config.data)
    if len(nodes) > 1 and config.data.get("validation") is not None:
        allowed = f"null with the {len(nodes)} records of data.records"
        raise InputError("data.validation", config.data.validation, allowed, "it belongs to one record")
    measured = []
    for number, node in enumerate(nodes, start=1):
        with of_record(number, len(nodes)), in_names(structure.labels):
            measured.append(build(node, "data", base=base))
    return measured


def _named_record(measured: Any, connections: Sequence[str], true: Structure) -> Measurements:
    return named(partial(measured.measure, connections=connections), true.ndof, true.labels)


def _source(config: DictConfig, structure: Structure, model_error: ModelError, seed: int, base: Path | None) -> Source:
    from pinn_cli.record.noise import Noise
    from pinn_cli.record.simulation import Simulation
    from pinn_cli.record.size import check_size
    from pinn_cli.record.validation_data import validation_of

    if not _is_simulated(config):
        measured = _measured(config, structure, base)
        if model_error.name != "none":
            hint = "a measured record brings its own truth; system=... is the model that you prescribe"
            raise InputError("model_error", model_error.name, "none unless data=simulated", hint)
        labels, count = structure.labels, structure.incidence.shape[0]
        connections = [labels.connection(i) for i in range(count)]
        with in_names(structure.labels):
            held = validation_of(measured[0])
        seen = measured if held is None else [held.seen]
        first, *further = (partial(_named_record, each, connections) for each in seen)
        validate = None if held is None else partial(_validation_record, held, connections)
        return Source(first, False, None, validate, tuple(further))
    simulation = construct(Simulation, config.simulation, "simulation")
    noise = construct(Noise, config.noise, "noise", seed=seed)
    check_size(simulation, structure, noise.repeats)
    span = {"ndof": structure.ndof, "duration": simulation.duration, "samples": simulation.samples}
    excitation = build(config.excitation, "excitation", base=base, **span)
    simulated = build(config.data, "data", excitation=excitation, simulation=simulation, noise=noise)
    return Source(lambda true: named(simulated.measure, true, true.labels), simulated=True, snr_db=noise.snr_db)


def _validation_record(
    held: ValidationData, connections: Sequence[str], true: Structure, seen: Record
) -> ValidationRecord:
    with in_names(true.labels):
        found = held.read(seen, true.ndof, connections)
    return replace(found, record=replace(found.record, dofs=true.labels.dofs))
