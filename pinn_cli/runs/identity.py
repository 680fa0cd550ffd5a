"""What the numbers of a run depend on: which run a checkpoint or a result is of. Nothing slow is imported here."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pinn_cli.settings.legal_values import located

if TYPE_CHECKING:
    from omegaconf import DictConfig

# Where and how a run is made, which may differ from one start of it to the next.
HOW_IT_IS_MADE = (
    "device", "threads", "resume", "figures", "report", "strict", "tracking", "training.checkpoint_every_s", "follow",
)  # fmt: skip
# Files that are read: their content counts, not their name.
FILES = ("data.path", "data.validation.path", "excitation.path", "system.path", "system.M", "system.K", "system.C")
PACKAGES = ("pinn-cli", "torch", "numpy", "scipy")
WINDOWS = ("data.window", "data.overlap")


@dataclass(frozen=True)
class Identity:
    """One run among all runs.

    Attributes:
        settings: Value of every setting that the numbers depend on, as text, by the name that a user types; of a file
            that is read its content instead of its name.
        versions: Of the packages that compute them.
    """

    settings: dict[str, str]
    versions: dict[str, str]

    @classmethod
    def of(cls, config: DictConfig, base: Path | None = None, grows: bool = False) -> Identity:
        """Of a composed configuration, resolvable and without its `hydra` node.

        Relative paths of data start from ``base``, None: the current folder. A record that grows goes by its name.
        """
        from omegaconf import ListConfig, OmegaConf

        settings = {name: value for name, value in flattened(config).items() if not is_left_out(name)}
        settings.pop("model", None)
        for name in WINDOWS:
            if settings.get(name) == "null":  # as before there were any
                settings.pop(name)
        records = OmegaConf.select(config, "data.records")
        records = records if isinstance(records, ListConfig) else []
        for name in (*FILES, *(f"data.records[{i}].path" for i in range(len(records)))):
            path = OmegaConf.select(config, name)
            paths = path if isinstance(path, ListConfig) else [] if path is None else [path]
            if grows and name == "data.path":
                settings[name] = ", ".join(str(located(str(path), base)) for path in paths)
                continue
            contents = [_content(located(str(path), base)) for path in paths]
            if contents and all(contents):
                settings[name] = ", ".join(map(str, contents))
        if config.get("model") is not None:  # which the run begins with
            given = str(config.model)
            settings["model"] = _content(located(given, base) / "model.npz") or given
        return cls(settings, {name: package_version(name) or "unknown" for name in PACKAGES})

    @property
    def configuration(self) -> str:
        """SHA-256 of the settings alone."""
        return hashlib.sha256(json.dumps(self.settings, sort_keys=True).encode()).hexdigest()

    def changes_from(self, other: Identity) -> list[str]:
        """What differs, as `noise.snr_db=20 (was 50)`."""
        return [
            f"{name}={now.get(name, '(none)')} (was {was.get(name, '(none)')})"
            for now, was in ((self.settings, other.settings), (self.versions, other.versions))
            for name in sorted(now.keys() | was.keys())
            if now.get(name) != was.get(name)
        ]


def is_left_out(name: str) -> bool:
    """Whether a setting is one of `HOW_IT_IS_MADE`, or belongs to a group that is."""
    return any(name == other or name.startswith(f"{other}.") for other in HOW_IT_IS_MADE)


def flattened(config: DictConfig) -> dict[str, str]:
    """Every setting of a composed configuration by the name that a user types, as text."""
    from omegaconf import OmegaConf

    return dict(_flat(OmegaConf.to_container(config, resolve=True)))


def _flat(node: Any, name: str = "") -> Iterator[tuple[str, str]]:
    """Names and values of the leaves; a number is the same whether it is written 50 or 50.0."""
    if isinstance(node, Mapping) and (node or not name):
        for key, value in node.items():
            yield from _flat(value, f"{name}.{key}" if name else str(key))
    elif isinstance(node, list) and any(isinstance(item, Mapping | list) for item in node):
        for index, item in enumerate(node):
            yield from _flat(item, f"{name}[{index}]")
    else:
        yield name, _text(node)


def _text(value: Any) -> str:
    if isinstance(value, list):
        return f"[{','.join(map(_text, value))}]"
    if isinstance(value, int | float) and not isinstance(value, bool):
        return repr(int(value)) if value == value // 1 else repr(float(value))
    return "null" if value is None else str(value)


def _content(file: Path) -> str | None:
    try:
        if not file.is_file():  # a pipe would be waited for, a device would never end
            return None
        return f"file of SHA-256 {hashlib.sha256(file.read_bytes()).hexdigest()[:16]}"
    except (OSError, ValueError):  # whoever needs it says so
        return None


@cache  # a sweep asks for them for every job
def package_version(name: str) -> str | None:
    """Of a package as it is installed; None where it is not, as a checkout that was never installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None
