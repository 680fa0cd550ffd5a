"""How configurations are composed: by Hydra, and none is used before it is checked."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from hydra import initialize_config_module
from hydra.core.config_loader import ConfigLoader
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from pinn_cli.cli.unused import check_choices, check_used
from pinn_cli.settings.config_folder import as_folder
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.hydra_node import check_hydra, check_search_path
from pinn_cli.settings.instantiation import check_classes
from pinn_cli.settings.interpolations import check_interpolations
from pinn_cli.settings.override_syntax import quoted

CONFIG, SEARCH_PATH = "config", "hydra.searchpath"


def _as_hydras(name: str) -> Any:
    return lambda loader, *args, **kwargs: getattr(loader.hydras, name)(*args, **kwargs)


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
            InputError: A class is not registered, Hydra would do what `check_hydra` refuses, something is not used,
                or a file cannot be read.
        """
        check_choices(overrides)
        overrides = in_folders(overrides)
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
        sweep_overrides = in_folders(sweep_overrides)
        config = self.hydras.load_sweep_config(master_config, sweep_overrides)
        return _checked(config, [*of_hydra, *sweep_overrides])

    compute_defaults_list = _as_hydras("compute_defaults_list")
    get_group_options = _as_hydras("get_group_options")
    get_search_path = _as_hydras("get_search_path")
    get_sources = _as_hydras("get_sources")
    list_groups = _as_hydras("list_groups")


@contextmanager
def checked_hydra() -> Iterator[CheckedLoader]:
    """Hydra with the configurations of this package, within the block."""
    with initialize_config_module("pinn_cli.conf", "pinn-run", version_base="1.3"):
        yield CheckedLoader(GlobalHydra.instance().config_loader())


def in_folders(overrides: Sequence[str], config_dir: str | None = None) -> list[str]:
    """The same overrides, the folders that they have searched as `folder://`, `--config-dir` first.

    Hydra itself would read a file without a limit, and import a package.

    Raises:
        InputError: A folder is missing, or something else than folders is to be searched.
    """
    if config_dir is not None and not (config_dir and Path(config_dir).is_dir()):
        hint = "" if config_dir else "is a variable of the shell empty?"
        raise InputError("--config-dir", config_dir or "''", "an existing folder", hint)
    kept, places = [], [] if config_dir is None else [str(Path(config_dir).absolute())]
    for override in overrides:
        (parsed,) = OverridesParser.create().parse_overrides([override]) if "searchpath" in override else (None,)
        if parsed is None or parsed.key_or_group != SEARCH_PATH or parsed.is_delete():
            kept.append(override)
            continue
        value: Any = parsed.value()
        check_search_path(value)
        places += value
    return [*kept, f"{SEARCH_PATH}=[{','.join(quoted(as_folder(place)) for place in places)}]"] if places else kept


def as_hydra_reads(override: str) -> str:
    """A mapping that is given, as `data.force={1: f1}`, may have keys of its own: Hydra wants a `++` for them.

    Whether a key is known is checked when the configuration is read.
    """
    return re.sub(r"^(?=[\w.]+=\{)", "++", override)


def _checked(config: DictConfig, overrides: Sequence[str]) -> DictConfig:
    check_hydra(config, overrides)
    check_used(config, overrides)
    plain: Any = OmegaConf.to_container(config, resolve=False)
    hydra = plain.pop("hydra")
    check_interpolations({**plain, "hydra": hydra}, _own_text())  # Hydra's last: it repeats what is typed
    check_classes(plain)
    return config


@cache
def _own_text() -> str:
    return (files("pinn_cli.conf") / f"{CONFIG}.yaml").read_text(encoding="utf-8")
