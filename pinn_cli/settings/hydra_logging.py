"""What logs may be configured to do: write to the terminal, in any format, at any level.

Python's `logging.config` calls whatever a configuration names: `()` of a handler, a `class`, and any value that begins
with `ext://`. Here a handler is of one class, and every entry is one of those listed. The run's own log is no part of
this: `pinn_cli.runs.log` writes it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from pinn_cli.settings.errors import InputError

STREAM = "logging.StreamHandler"
STREAMS = ("ext://sys.stdout", "ext://sys.stderr")


def _text(value: object) -> bool:
    # What begins with a protocol is looked up by Python, and what is interpolated by OmegaConf.
    return isinstance(value, str) and not re.match(r"\s*[a-z]+://", value) and "${" not in value


def _level(value: object) -> bool:
    return isinstance(value, int) or (isinstance(value, str) and re.fullmatch(r"[A-Z]+", value) is not None)


def _names(value: object) -> bool:
    return isinstance(value, list) and all(map(_text, value))


def _switch(value: object) -> bool:
    return isinstance(value, bool)


Allowed = Mapping[str, Callable[[Any], bool]]

_FORMATTER: Allowed = {"format": _text, "datefmt": _text}
_LOGGER: Allowed = {"level": _level, "handlers": _names, "propagate": _switch}
_HANDLER: Allowed = {"class": STREAM.__eq__, "formatter": _text, "level": _level, "stream": STREAMS.__contains__}


def check_logging(setting: str, node: object) -> None:
    """Refuse a configuration of logs that calls something or writes elsewhere.

    Args:
        setting: `hydra.job_logging` or `hydra.hydra_logging`.
        node: Plain, as it is written.

    Raises:
        InputError: At the first entry that is refused.
    """
    if node is None:
        return
    content = _mapping(setting, node)
    _check(setting, {k: v for k, v in content.items() if k not in ("formatters", "handlers", "loggers", "root")},
           {"version": 1 .__eq__, "disable_existing_loggers": _switch})  # fmt: skip
    for name, formatter in _mapping(f"{setting}.formatters", content.get("formatters", {})).items():
        _check(f"{setting}.formatters.{name}", formatter, _FORMATTER)
    for name, handler in _mapping(f"{setting}.handlers", content.get("handlers", {})).items():
        place = f"{setting}.handlers.{name}"
        kind = str(_mapping(place, handler).get("class"))
        if kind != STREAM:
            raise InputError(f"{place}.class", kind, STREAM, _WHY)
        _check(place, handler, _HANDLER)
    for name, logger in _mapping(f"{setting}.loggers", content.get("loggers", {})).items():
        _check(f"{setting}.loggers.{name}", logger, _LOGGER)
    if content.get("root") is not None:
        _check(f"{setting}.root", content["root"], _LOGGER)


_WHY = "logs of these settings go to the terminal, and call nothing; a run writes its pinn-run.log itself"


def _mapping(setting: str, node: object) -> dict[Any, Any]:
    if not isinstance(node, dict):
        raise InputError(setting, node, "a mapping, written out")
    return node


def _check(setting: str, node: object, allowed: Allowed) -> None:
    for key, value in _mapping(setting, node).items():
        if key not in allowed:
            raise InputError(f"{setting}.{key}", value, f"one of {', '.join(allowed)}", _WHY)
        if not allowed[key](value):
            raise InputError(f"{setting}.{key}", value, "such that the log goes to the terminal", _WHY)
