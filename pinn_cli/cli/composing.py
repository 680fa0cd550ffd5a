"""How configurations are composed: by Hydra, and none is used before it is checked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hydra.core.config_loader import ConfigLoader
from hydra.core.global_hydra import GlobalHydra
from hydra.core.object_type import ObjectType
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from pinn_cli.settings.hydra_node import check_hydra, check_search_path
from pinn_cli.settings.instantiation import check_classes


class CheckedLoader(ConfigLoader):
    """Hydra's loader, which hands out no configuration that would run other code than registered classes.

    Args:
        hydras: That which Hydra has made.
    """

    def __init__(self, hydras: ConfigLoader) -> None:
        self.hydras = hydras

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
            InputError: It chooses a class that is not registered, or Hydra would do what `check_hydra` refuses.
        """
        _check_searched(overrides)
        config = self.hydras.load_configuration(config_name, overrides, run_mode, from_shell, validate_sweep_overrides)
        return _checked(config, overrides)

    def load_sweep_config(self, master_config: DictConfig, sweep_overrides: list[str]) -> DictConfig:
        """See :class:`hydra.core.config_loader.ConfigLoader`; raises what `load_configuration` does."""
        of_hydra: Any = OmegaConf.to_container(master_config.hydra.overrides.hydra, resolve=False)
        overrides = [*of_hydra, *sweep_overrides]
        _check_searched(overrides)
        return _checked(self.hydras.load_sweep_config(master_config, sweep_overrides), overrides)

    def get_group_options(
        self,
        group_name: str,
        results_filter: ObjectType | None = ObjectType.CONFIG,
        config_name: str | None = None,
        overrides: list[str] | None = None,
    ) -> list[str]:
        """See :class:`hydra.core.config_loader.ConfigLoader`."""
        _check_searched(overrides or [])
        return self.hydras.get_group_options(group_name, results_filter, config_name, overrides)

    def compute_defaults_list(self, config_name: str | None, overrides: list[str], run_mode: RunMode) -> Any:
        """See :class:`hydra.core.config_loader.ConfigLoader`."""
        _check_searched(overrides)
        return self.hydras.compute_defaults_list(config_name, overrides, run_mode)

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


def _check_searched(overrides: Sequence[str]) -> None:
    searched = [override for override in overrides if "searchpath" in override]
    for override in OverridesParser.create().parse_overrides(searched):
        if override.get_key_element().lstrip("+~") == "hydra.searchpath":
            check_search_path(override.value())


def _checked(config: DictConfig, overrides: Sequence[str]) -> DictConfig:
    check_hydra(config, overrides)
    task = OmegaConf.to_container(config, resolve=False)
    check_classes({name: node for name, node in task.items() if name != "hydra"})  # type: ignore[union-attr]
    return config
