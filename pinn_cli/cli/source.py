"""What vibrates, and where its record comes from: the structure, or a finished run's, and the source of the record."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from pinn_cli.cli.records import data_of_records, in_names, named, of_record
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.instantiation import CONF, build, construct
from pinn_cli.settings.yaml_file import read_yaml

if TYPE_CHECKING:
    from pinn_cli.model.knowledge import Model
    from pinn_cli.record.record import Measurements, Record
    from pinn_cli.record.validation_data import ValidationRecord
    from pinn_cli.record.windows import RecordWindows
    from pinn_cli.scheme.scheme import Scheme
    from pinn_cli.system.building import ModesSought
    from pinn_cli.system.model_error import ModelError
    from pinn_cli.system.parameters import Labels
    from pinn_cli.system.structure import Structure
    from pinn_cli.validation.validation import Validation

SIMULATED = "pinn_cli.record.simulated.Simulated"
# The structure whose modes a record tells.
MODAL = "modal"


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
        windows: The record window by window, where it is solved so; ``measure`` then has the whole of it.
    """

    measure: Callable[[Structure], Measurements]
    simulated: bool
    snr_db: float | None
    validate: Callable[[Structure, Sequence[Record]], ValidationRecord] | None = None
    further: tuple[Callable[[Structure], Measurements], ...] = ()
    windows: RecordWindows | None = None

    def measurements(self, true: Structure) -> list[Measurements]:
        """Those of every record."""
        measurements = []
        for number, measure in enumerate((self.measure, *self.further), start=1):
            with of_record(number, 1 + len(self.further)):
                measurements.append(measure(true))
        return measurements


def chosen_model(config: DictConfig, model_error: ModelError, base: Path | None) -> Model | None:
    """The finished run that ``model=RUN`` names, None: it names none; what does not go with one is refused."""
    if config.get("model") is None:
        return None
    from pinn_cli.model.file import read_model

    if model_error.name != "none":
        hint = "the model of a run is what it found"
        raise InputError("model_error", model_error.name, "none with model=...", hint)
    return read_model(config.model, base)


def check_use(model: Model | None, scheme: Any, validation: Any, given: Any) -> None:
    """Refuse a model that a scheme has no use for, and a validation where nothing is estimated."""
    if model is not None and "model" not in inspect.signature(type(scheme)).parameters:
        hint = "leave scheme out for the response to a new record, or ask for scheme=update"
        raise InputError("model", given, f"null with scheme={scheme.name}", hint)
    if scheme.predicts and validation.name != "none":
        raise InputError("validation", validation.name, "none with scheme=predict", "there is no response to withhold")


def read_structure(config: DictConfig, base: Path | None, model: Model | None = None) -> Structure:
    """The structure; of a measured one values may be missing, which the scheme then has to be asked for.

    A model stands in its place for a measured record; a simulated one comes from what the settings say.

    Raises:
        InputError: No structure has these settings, or they are another one than the model's.
    """
    simulated = _is_simulated(config)
    if model is not None:
        from pinn_cli.model.file import difference, other_dofs

        default = OmegaConf.to_container(read_yaml(CONF / "system" / "duffing.yaml"))
        if not simulated and OmegaConf.to_container(config.system) == default:  # nobody chose a structure
            return model.structure
        structure = read_structure(config, base)
        differs = other_dofs(structure, model.structure) if simulated else difference(structure, model.structure)
        if differs:
            hint = "simulate the structure of that run" if simulated else "leave system out: the run has it"
            raise InputError("system", differs, f"the structure of the run model={config.model}", hint)
        return structure if simulated else model.structure
    from pinn_cli.system.building import build_chain, build_modal, build_partial_chain
    from pinn_cli.system.quantities import FORCE, MOTION
    from pinn_cli.system.topology import build_structure, whole

    kind = config.system.get("kind")
    if kind == MODAL:  # of modes that the record has yet to tell, at the points that it names
        if simulated:
            raise InputError("system", MODAL, "another one with data=simulated", "a record tells the modes")
        return construct(build_modal, config.system, "system", measured=_dofs(config, (FORCE, *MOTION)))
    if kind == "matrices":
        structure = _finite_elements(config, base)
    elif kind == "structure":
        structure = construct(build_structure, config.system, "system")
    else:
        return construct(build_chain if simulated else build_partial_chain, config.system, "system")
    return whole(structure) if simulated else structure


def _finite_elements(config: DictConfig, base: Path | None) -> Structure:
    """A reduced model, with the static responses of the DOFs that carry a force or a sensor of a measured record."""
    from pinn_cli.system.finite_elements import build_finite_elements
    from pinn_cli.system.quantities import FORCE, MOTION

    if _is_simulated(config):
        forces = config.excitation.get("dofs")
        loaded = list(forces) if OmegaConf.is_config(forces) else []
    else:
        # With factors the model is reduced anew, sensors included, to coordinates as few as its first ones.
        quantities = (FORCE,) if config.system.get("factors") else (FORCE, *MOTION)
        loaded = list(dict.fromkeys(_dofs(config, quantities)))
    return construct(build_finite_elements, config.system, "system", base=base, loaded=loaded)


def _dofs(config: DictConfig, quantities: Collection[str]) -> list[Any]:
    """DOFs on which any measured record has a sensor of some quantities."""
    dofs: list[Any] = []
    for data in data_of_records(config.data):
        for columns in map(data.get, quantities):
            dofs += columns if OmegaConf.is_config(columns) else ()
        channels = data.get("channels")
        for channel in filter(OmegaConf.is_dict, channels.values() if OmegaConf.is_dict(channels) else ()):
            if channel.get("dof") is not None and channel.get("sensor") in quantities:
                dofs.append(channel.dof)
    return dofs


def _is_simulated(config: DictConfig) -> bool:
    simulated, kind = config.data.get("_target_") == SIMULATED, config.data.get("kind")
    if simulated != (kind == "simulated"):
        raise InputError("data.kind", kind, "left as the file of the option has it", "choose by data=...")
    return simulated


def modes_sought(config: DictConfig, scheme: Scheme, validation: Validation) -> ModesSought | None:
    """Which modes a record is asked for, as unknown parameters of it alone; None: the structure says it all."""
    if config.system.get("kind") != MODAL:
        for node in data_of_records(config.data) if config.data.get("band") is not None else []:
            hint = "the noise of other estimators is white, and a filter leaves none beside its band: data.decimate"
            raise InputError("data.band", list(node.band), "null but with system=modal", hint)
        return None
    from pinn_cli.system.building import ModesSought

    if scheme.name != "state_parameter":
        raise InputError("scheme", scheme.name, "state_parameter with system=modal")
    for setting in ("data.window", "scheme.unknown", "model"):
        given = OmegaConf.select(config, setting)
        if given is not None:
            raise InputError(setting, given, "null with system=modal", "one record tells all modes in its band")
    if validation.name != "none":
        raise InputError("validation", validation.name, "none with system=modal", "see data.validation")
    return ModesSought.of(config.system.get("modes"))


def read_source(
    config: DictConfig,
    structure: Structure,
    model_error: ModelError,
    scheme: Scheme,
    seed: int,
    base: Path | None,
    follows: bool = False,
) -> Source:
    """Where the record comes from: simulated with noise of this seed, or measured, in which case it may still grow.

    Raises:
        InputError: A setting that no record can have.
    """
    from pinn_cli.record.simulated import Noise, check_size
    from pinn_cli.record.simulation import Simulation
    from pinn_cli.system.basis import reduced_at

    if not _is_simulated(config):
        if model_error.name != "none":
            hint = "a measured record brings its own truth; system=... is the model that you prescribe"
            raise InputError("model_error", model_error.name, "none unless data=simulated", hint)
        return _measured_source(config, structure, not scheme.predicts, base, follows)
    simulation = construct(Simulation, config.simulation, "simulation")
    noise = construct(Noise, config.noise, "noise", seed=seed)
    check_size(simulation, structure, noise.repeats)
    span = {"ndof": structure.ndof, "duration": simulation.duration, "samples": simulation.samples}
    excitation = build(config.excitation, "excitation", base=base, **span)
    (data,) = data_of_records(config.data)
    simulated = build(data, "data", excitation=excitation, simulation=simulation, noise=noise)
    return Source(
        lambda true: measured_by_name(partial(simulated.measure, reduced_at(true)), true.labels),
        simulated=True,
        snr_db=noise.snr_db,
        windows=_windows_of(config, simulated, [], follows),
    )


def _measured_source(
    config: DictConfig, structure: Structure, responds: bool, base: Path | None, follows: bool
) -> Source:
    from pinn_cli.record.validation_data import ValidationData

    nodes, labels = data_of_records(config.data), structure.labels
    measured: list[Any] = []
    for number, node in enumerate(nodes, start=1):
        with of_record(number, len(nodes)), in_names(labels):
            measured.append(build(node, "data", base=base, responds=responds))
    connections = [labels.connection(i) for i in range(len(structure.parameters["k"]))]
    with in_names(labels):
        held = ValidationData.among(measured)
    seen = measured if held is None else held.seen

    def measure(data: Any, true: Structure) -> Measurements:
        return measured_by_name(partial(data.measure, true.ndof, connections=connections), true.labels)

    def validate(true: Structure, seen: Sequence[Record]) -> ValidationRecord:
        assert held is not None
        with in_names(true.labels):
            validation = held.read(seen, true.ndof, connections)
        return replace(validation, record=named(validation.record, true.labels))

    first, *further = (partial(measure, data) for data in seen)
    windows = _windows_of(config, seen[0], connections, follows)
    return Source(first, False, None, None if held is None else validate, tuple(further), windows)


def measured_by_name(measure: Callable[[], Measurements], labels: Labels) -> Measurements:
    """What was measured, DOFs in its record and in errors by the names that the user has given them."""
    with in_names(labels):
        measured = measure()
    return replace(measured, record=named(measured.record, labels))


def _windows_of(config: DictConfig, data: Any, connections: list[str], follows: bool) -> RecordWindows | None:
    """The windows that `data.window` asks for; None where it asks for none."""
    from pinn_cli.record.measured_data import MeasuredData
    from pinn_cli.record.simulated import Simulated
    from pinn_cli.record.windows import GrowingWindows, MeasuredWindows, Patience, SimulatedWindows, checked_lengths

    window, overlap = config.data.get("window"), config.data.get("overlap")
    if window is None:
        if follows:
            raise InputError("data.window", None, "given with follow, in seconds", "a record is followed by windows")
        if overlap is not None:
            raise InputError("data.overlap", overlap, "null without data.window", "both are in seconds")
        return None
    lengths, kind = checked_lengths(window, overlap), config.data.get("kind")
    if follows and not isinstance(data, MeasuredData):
        hint = "follow reads a file that grows, or a folder into which files arrive"
        raise InputError("data", kind, "csv or another format of files with follow", hint)
    if isinstance(data, Simulated):
        return SimulatedWindows(data, *lengths)
    if not isinstance(data, MeasuredData):
        raise InputError("data.window", window, f"null with data={kind}", "a class of your own measures it as a whole")
    hint = "its filter would have an edge in every window"
    if data.decimate > 1:
        raise InputError("data.decimate", data.decimate, "1 with data.window", hint)
    if data.band is not None:
        raise InputError("data.band", list(data.band), "null with data.window", hint)
    if follows:
        return GrowingWindows(data, connections, *lengths, construct(Patience, config.follow, "follow"))
    return MeasuredWindows(data, connections, *lengths)
