"""`model=RUN`: a finished run in the place of a structure."""

from __future__ import annotations

import inspect
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from pinn_cli.cli.source import SIMULATED, read_structure
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.yaml_file import read_yaml

if TYPE_CHECKING:
    from pinn_cli.model.knowledge import Model
    from pinn_cli.system.structure import Structure

SETTING = "model"


def chosen_model(config: DictConfig, base: Path | None) -> Model | None:
    """The model that a configuration names; None where it names none.

    Raises:
        InputError: It is none, or something is asked for that does not go with one.
    """
    if config.get(SETTING) is None:
        return None
    from pinn_cli.model.file import read_model

    if config.model_error.get("_target_") != "pinn_cli.system.model_error.none.NoModelError":
        raise InputError("model_error", "given", "none with model=...", "the model of a run is what it found")
    return read_model(config.model, base)


def structure_beside(model: Model, config: DictConfig, base: Path | None) -> Structure:
    """What a simulated record comes from; of a measured one the model's structure.

    Raises:
        InputError: `system` is another structure than the model's.
    """
    from pinn_cli.model.file import difference, other_dofs

    measured = config.data.get("_target_") != SIMULATED
    if measured and _is_untouched(config.system):
        return model.structure
    structure = read_structure(config, base)
    differs = difference(structure, model.structure) if measured else other_dofs(structure, model.structure)
    if differs:
        hint = "leave system out: the run has it" if measured else "simulate the structure of that run"
        raise InputError("system", differs, f"the structure of the run model={config.model}", hint)
    return model.structure if measured else structure


def check_use(model: Model | None, scheme: Any, validation: Any, given: Any) -> None:
    """See that a scheme has a use for the model.

    Raises:
        InputError: It has none.
    """
    if model is not None and "model" not in inspect.signature(type(scheme)).parameters:
        hint = "leave scheme out for the response to a new record, or ask for scheme=update"
        raise InputError(SETTING, given, f"null with scheme={scheme.name}", hint)
    if scheme.predicts and validation.name != "none":
        raise InputError("validation", validation.name, "none with scheme=predict", "there is no response to withhold")


def _is_untouched(system: DictConfig) -> bool:
    """Whether it is what stands there where nobody chooses a structure."""
    shipped = Path(str(files("pinn_cli.conf") / "config.yaml")).parent / "system" / "duffing.yaml"
    default = OmegaConf.to_container(read_yaml(shipped))
    return OmegaConf.to_container(system) == default
