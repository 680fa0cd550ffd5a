"""How configurations are composed: by Hydra, and none is used before it is checked."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

from hydra.core.config_loader import ConfigLoader
from hydra.core.global_hydra import GlobalHydra
from hydra.core.object_type import ObjectType
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from pinn_cli.cli.unused import check_choices, check_used
from pinn_cli.settings.config_folder import HYDRAS, ConfigFolder, as_folder
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.hydra_node import check_hydra, check_search_path
from pinn_cli.settings.instantiation import check_classes
from pinn_cli.settings.interpolations import check_interpolations
from pinn_cli.settings.override_syntax import quoted


class CheckedLoader(ConfigLoader):
    """Hydra's loader, which hands out no configuration that would run other code than registered classes.

    Args:
        hydras: That which Hydra has made.
    """

    def __init__(self, hydras: ConfigLoader) -> None:
        self.hydras = hydras
        for element in hydras.get_search_path().get_path():
            element.path = as_folder(element.path)
        sources = hydras.get_sources()  # made of that path already
        sources[:] = [
            ConfigFolder(s.provider, as_folder(s.full_path())) if s.scheme() == HYDRAS else s for s in sources
        ]

    def load_configuration(
        self,
        config_name: str | None,
        overrides: list[str],
        run_mode: RunMode,
        from_shell: bool = True,
        validate_sweep_overrides: bool = True,
    ) -> DictConfig:
        """See :class:`hydra.core.config_loader.ConfigLoader`.

        Raises:
            InputError: A class is not registered, Hydra would do what `check_hydra` refuses, something is not used,
                or a file cannot be read.
        """
        check_choices(overrides)
        overrides = _in_folders(overrides)
        try:
            config = self.hydras.load_configuration(
                config_name, overrides, run_mode, from_shell, validate_sweep_overrides
            )
        except KeyError as error:
            if error.args[0] in os.environ:
                raise
            raise InputError("hydra.job.env_copy", error.args[0], "names of variables that are set") from error
        return _checked(config, overrides)

    def load_sweep_config(self, master_config: DictConfig, sweep_overrides: list[str]) -> DictConfig:
        """See :class:`hydra.core.config_loader.ConfigLoader`; raises what `load_configuration` does."""
        of_hydra: Any = OmegaConf.to_container(master_config.hydra.overrides.hydra, resolve=False)
        overrides, sweep_overrides = _in_folders([*of_hydra, *sweep_overrides]), _in_folders(sweep_overrides)
        return _checked(self.hydras.load_sweep_config(master_config, sweep_overrides), overrides)

    def get_group_options(
        self,
        group_name: str,
        results_filter: ObjectType | None = ObjectType.CONFIG,
        config_name: str | None = None,
        overrides: list[str] | None = None,
    ) -> list[str]:
        """See :class:`hydra.core.config_loader.ConfigLoader`."""
        return self.hydras.get_group_options(group_name, results_filter, config_name, _in_folders(overrides or []))

    def compute_defaults_list(self, config_name: str | None, overrides: list[str], run_mode: RunMode) -> Any:
        """See :class:`hydra.core.config_loader.ConfigLoader`."""
        return self.hydras.compute_defaults_list(config_name, _in_folders(overrides), run_mode)

    def get_search_path(self) -> Any:
        """See :class:`hydra.core.config_loader.ConfigLoader`."""
        return self.hydras.get_search_path()

    def get_sources(self) -> Any:
        """See :class:`hydra.core.config_loader.ConfigLoader`."""
        return self.hydras.get_sources()

    def list_groups(self, parent_name: str) -> list[str]:
        """See :class:`hydra.core.config_loader.ConfigLoader`."""
        return self.hydras.list_groups(parent_name)


class CheckedHydra(GlobalHydra):
    """The one Hydra of this process: it gets a `CheckedLoader` before it composes anything."""

    def initialize(self, hydra: Any) -> None:
        """See :class:`hydra.core.global_hydra.GlobalHydra`."""
        hydra.config_loader = CheckedLoader(hydra.config_loader)
        super().initialize(hydra)


def check_what_is_composed() -> None:
    """See to it that all that Hydra composes in this process from here on is checked."""
    if not isinstance(GlobalHydra.instance(), CheckedHydra):
        checked = CheckedHydra()
        checked.clear()
        GlobalHydra.set_instance(checked)


def _in_folders(overrides: Sequence[str]) -> list[str]:
    """The same overrides, the folders that they have searched as :class:`ConfigFolder`; others are refused."""
    return [_searched(override) if "searchpath" in override else override for override in overrides]


def _searched(override: str) -> str:
    (parsed,) = OverridesParser.create().parse_overrides([override])
    if parsed.key_or_group != "hydra.searchpath" or parsed.is_delete():
        return override
    places: Any = parsed.value()
    check_search_path(places)
    name, _, _ = override.partition("=")
    return f"{name}=[{','.join(quoted(as_folder(place)) for place in places)}]"


def _checked(config: DictConfig, overrides: Sequence[str]) -> DictConfig:
    check_hydra(config, overrides)
    check_used(config, overrides)
    plain: Any = OmegaConf.to_container(config, resolve=False)
    check_interpolations(plain)
    check_classes({name: node for name, node in plain.items() if name != "hydra"})
    return config
