"""What vibrates, and where its record comes from: the structure and the source of a configuration."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from pinn_cli.cli.dof_names import described, in_names, named
from pinn_cli.cli.records import data_of_records, of_record
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.instantiation import build, construct

if TYPE_CHECKING:
    from pinn_cli.record.record import Measurements, Record
    from pinn_cli.record.validation_data import ValidationData, ValidationRecord
    from pinn_cli.record.windows import RecordWindows
    from pinn_cli.system.building import ModesSought
    from pinn_cli.system.model_error import ModelError
    from pinn_cli.system.structure import Structure

SIMULATED = "pinn_cli.record.simulated.Simulated"
# The scheme whose records have no response.
PREDICT = "pinn_cli.scheme.predict.Predict"
# That of modes, and the structure whose modes a record tells.
NO_VALIDATION = "pinn_cli.validation.none.NoValidation"
STATE_PARAMETER, MODAL = "pinn_cli.scheme.state_parameter.StateParameter", "modal"


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
        each = (self.measure, *self.further)
        found = []
        for number, measure in enumerate(each, start=1):
            with of_record(number, len(each)):
                found.append(measure(true))
        return found


def read_structure(config: DictConfig, base: Path | None) -> Structure:
    """The structure; of a measured one values may be missing, which the scheme then has to be asked for."""
    from pinn_cli.system.building import build_chain, build_partial_chain
    from pinn_cli.system.topology import build_partial_structure, build_structure

    if config.system.get("kind") == "matrices":
        return _finite_elements(config, base)
    if config.system.get("kind") == MODAL:
        return _modal(config)
    named = config.system.get("kind") == "structure"
    whole, incomplete = (build_structure, build_partial_structure) if named else (build_chain, build_partial_chain)
    return construct(whole if _is_simulated(config) else incomplete, config.system, "system")


def _modal(config: DictConfig) -> Structure:
    """Of modes that the record has yet to tell, at the points that it names."""
    from pinn_cli.system.building import build_modal
    from pinn_cli.system.quantities import FORCE, MOTION

    if _is_simulated(config):
        raise InputError("system", MODAL, "another one with data=simulated", "a record tells the modes")
    nodes = data_of_records(config.data)
    return construct(
        build_modal, config.system, "system", measured=[dof for n in nodes for dof in _dofs(n, (FORCE, *MOTION))]
    )


def modes_sought(config: DictConfig) -> ModesSought | None:
    """Which modes a record is asked for; None: the structure says it all.

    Raises:
        InputError: They are not asked for as unknown parameters of one record.
    """
    if config.system.get("kind") != MODAL:
        for node in data_of_records(config.data) if config.data.get("band") is not None else []:
            hint = "the noise of other estimators is white, and a filter leaves none beside its band: data.decimate"
            raise InputError("data.band", list(node.band), "null but with system=modal", hint)
        return None
    from pinn_cli.system.building import ModesSought

    if config.scheme.get("_target_") != STATE_PARAMETER:
        raise InputError("scheme", config.scheme.get("_target_"), "state_parameter with system=modal")
    for setting in ("data.window", "scheme.unknown", "model"):
        if OmegaConf.select(config, setting) is not None:
            given = OmegaConf.select(config, setting)
            raise InputError(setting, given, "null with system=modal", "one record tells all modes in its band")
    if config.validation.get("_target_") != NO_VALIDATION:
        raise InputError(
            "validation", config.validation.get("_target_"), "none with system=modal", "see data.validation"
        )
    return ModesSought.of(config.system.get("modes"))


def _finite_elements(config: DictConfig, base: Path | None) -> Structure:
    """A reduced model, with the static responses of the DOFs that carry a force or a sensor of a measured record."""
    from pinn_cli.system.finite_elements import build_finite_elements
    from pinn_cli.system.quantities import FORCE, MOTION
    from pinn_cli.system.topology import whole

    if _is_simulated(config):
        forces = config.excitation.get("dofs")
        loaded = list(forces) if OmegaConf.is_config(forces) else []
    else:
        # With factors the model is reduced anew, sensors included, to coordinates as few as its first ones.
        quantities = (FORCE,) if config.system.get("factors") else (FORCE, *MOTION)
        loaded = list(dict.fromkeys(dof for node in data_of_records(config.data) for dof in _dofs(node, quantities)))
    structure = construct(build_finite_elements, config.system, "system", base=base, loaded=loaded)
    return whole(structure) if _is_simulated(config) else structure


def _dofs(data: DictConfig, quantities: Collection[str]) -> list[Any]:
    """DOFs on which one measured record has a sensor of some quantities."""
    columns, channels = [data.get(quantity) for quantity in quantities], data.get("channels")
    described = [one for one in channels.values() if OmegaConf.is_dict(one)] if OmegaConf.is_dict(channels) else []
    own = [one.dof for one in described if one.get("dof") is not None and one.get("sensor") in quantities]
    return [*(dof for column in columns if OmegaConf.is_config(column) for dof in column), *own]


def _is_simulated(config: DictConfig) -> bool:
    simulated, kind = config.data.get("_target_") == SIMULATED, config.data.get("kind")
    if simulated != (kind == "simulated"):
        raise InputError("data.kind", kind, "left as the file of the option has it", "choose by data=...")
    return simulated


def _measured(config: DictConfig, structure: Structure, base: Path | None) -> list[Any]:
    """What measures every record of `data`."""
    nodes = data_of_records(config.data)
    measured, responds = [], config.scheme.get("_target_") != PREDICT
    for number, node in enumerate(nodes, start=1):
        with of_record(number, len(nodes)), in_names(structure.labels):
            measured.append(build(node, "data", base=base, responds=responds))
    return measured


def _named_record(measured: Any, connections: Sequence[str], true: Structure) -> Measurements:
    return named(partial(measured.measure, connections=connections), true.ndof, true.labels)


def read_source(
    config: DictConfig,
    structure: Structure,
    model_error: ModelError,
    seed: int,
    base: Path | None,
    follows: bool = False,
) -> Source:
    """Where the record comes from.

    Args:
        config: Of the run.
        structure: That it is about.
        model_error: What differs between the true and the prescribed one.
        seed: Of the noise.
        base: The folder that relative paths of data start from.
        follows: Whether a measured record may still grow.

    Raises:
        InputError: A setting that no record can have.
    """
    from pinn_cli.record.simulated import Noise, check_size
    from pinn_cli.record.simulation import Simulation
    from pinn_cli.record.validation_data import validation_of

    if not _is_simulated(config):
        measured = _measured(config, structure, base)
        if model_error.name != "none":
            hint = "a measured record brings its own truth; system=... is the model that you prescribe"
            raise InputError("model_error", model_error.name, "none unless data=simulated", hint)
        labels, count = structure.labels, len(structure.parameters["k"])
        connections = [labels.connection(i) for i in range(count)]
        with in_names(structure.labels):
            held = validation_of(measured)
        seen = measured if held is None else held.seen
        first, *further = (partial(_named_record, each, connections) for each in seen)
        validate = None if held is None else partial(_validation_record, held, connections)
        windows = _windows_of(config, seen[0], connections, follows)
        return Source(first, False, None, validate, tuple(further), windows)
    simulation = construct(Simulation, config.simulation, "simulation")
    noise = construct(Noise, config.noise, "noise", seed=seed)
    check_size(simulation, structure, noise.repeats)
    span = {"ndof": structure.ndof, "duration": simulation.duration, "samples": simulation.samples}
    excitation = build(config.excitation, "excitation", base=base, **span)
    (data,) = data_of_records(config.data)
    simulated = build(data, "data", excitation=excitation, simulation=simulation, noise=noise)
    return Source(
        lambda true: named(simulated.measure, true.reduced_at(), true.labels),
        simulated=True,
        snr_db=noise.snr_db,
        windows=_windows_of(config, simulated, [], follows),
    )


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
    lengths = checked_lengths(window, overlap)
    if follows and not isinstance(data, MeasuredData):
        hint = "follow reads a file that grows, or a folder into which files arrive"
        raise InputError("data", config.data.get("kind"), "csv or another format of files with follow", hint)
    if isinstance(data, Simulated):
        return SimulatedWindows(data, *lengths)
    if not isinstance(data, MeasuredData):
        hint = "a class of your own measures it as a whole"
        raise InputError("data.window", window, f"null with data={config.data.get('kind')}", hint)
    if data.decimate > 1:
        hint = "its filter would have an edge in every window"
        raise InputError("data.decimate", data.decimate, "1 with data.window", hint)
    if data.band is not None:
        hint = "its filter would have an edge in every window"
        raise InputError("data.band", list(data.band), "null with data.window", hint)
    if follows:
        return GrowingWindows(data, connections, *lengths, construct(Patience, config.follow, "follow"))
    return MeasuredWindows(data, connections, *lengths)


def _validation_record(
    held: ValidationData, connections: Sequence[str], true: Structure, seen: Sequence[Record]
) -> ValidationRecord:
    with in_names(true.labels):
        found = held.read(seen, true.ndof, connections)
    return replace(found, record=described(found.record, true.labels))
