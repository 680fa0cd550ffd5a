"""Laws of connections by their names, those of installed plug-ins included."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from functools import cache
from typing import TYPE_CHECKING, Any

from omegaconf import OmegaConf

from pinn_cli.settings.errors import InputError, suggestion
from pinn_cli.settings.instantiation import construct, plugins_of
from pinn_cli.system import connection
from pinn_cli.system.connection.base import Nonlinearity

if TYPE_CHECKING:
    from collections.abc import Mapping


def law_settings(name: Any, setting: str) -> tuple[str, ...]:
    """Names of the settings that a law has beside its parameters.

    Raises:
        InputError: Naming ``setting``: there is no such law.
    """
    return tuple(inspect.signature(_law(name, setting)).parameters)


def law_called(name: Any, settings: Mapping[str, Any], setting: str) -> Nonlinearity:
    """The law of a connection.

    Args:
        name: ``duffing``, or what follows ``system.`` in the name of a plug-in's entry point.
        settings: Of the law.
        setting: Name of the connection as a user types it, for messages.

    Raises:
        InputError: There is no such law; a setting is missing, unknown or illegal.
    """
    try:
        law: Nonlinearity = construct(_law(name, f"{setting}.law"), OmegaConf.create(dict(settings)), setting)
    except InputError as error:
        # A law's own messages name it as a chain's.
        named = error.setting.replace("system.nonlinearity", setting, 1)
        raise InputError(named, error.value, error.allowed, error.hint) from None
    return law


def _law(name: Any, setting: str) -> type[Nonlinearity]:
    known = _shipped()
    if isinstance(name, str) and name in known:
        return known[name]
    # A package that is installed beside this one declares its laws: `"system.rubber" = "my_laws.rubber:Rubber"`.
    plugins = plugins_of("system")
    names = [*known, *plugins]
    if not isinstance(name, str) or name not in plugins:
        raise InputError(setting, name, f"one of {', '.join(names)}", suggestion(str(name), names))
    found: type[Nonlinearity] = plugins[name].load()
    return found


@cache
def _shipped() -> dict[str, type[Nonlinearity]]:
    """Name to class, of every law that has a file."""
    files = [
        importlib.import_module(f"{connection.__name__}.{m.name}") for m in pkgutil.iter_modules(connection.__path__)
    ]
    classes = [member for file in files for _, member in inspect.getmembers(file, inspect.isclass)]
    return {law.name: law for law in classes if issubclass(law, Nonlinearity) and not inspect.isabstract(law)}
