"""`pinn-run --json-schema`: what a file of settings may say, for editors that complete and check YAML.

Names, defaults and explanations are those of the files of conf/. Types and choices are those that the classes which the
settings are handed to annotate: `Annotated[str, CHOICES]` has the very choices that such a class checks. What else a
value must be is left to the run. A group's settings are those of one of its options.
"""

from __future__ import annotations

import importlib
import inspect
import re
import sys
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from omegaconf import OmegaConf

from pinn_cli.cli.config import NODES, RunConfig
from pinn_cli.cli.help import files_of, option_names
from pinn_cli.settings.instantiation import check_registered
from pinn_cli.settings.yaml_file import read_yaml

Schema = dict[str, Any]

# Drafts after it are not read by every editor.
DRAFT = "http://json-schema.org/draft-07/schema#"
PLAIN = {bool: "boolean", int: "integer", float: "number", str: "string", type(None): "null"}
# What a group's settings are handed to where no `_target_` says so; of a system by its kind.
MADE_BY = {
    "simulation": "pinn_cli.record.simulation.Simulation",
    "noise": "pinn_cli.record.simulated.Noise",
    "follow": "pinn_cli.record.windows.Patience",
    "report": "pinn_cli.report.export.report_settings",
    "system": "pinn_cli.system.building.build_partial_chain",
    "system structure": "pinn_cli.system.topology.build_structure",
    "system matrices": "pinn_cli.system.finite_elements.build_finite_elements",
    "system modal": "pinn_cli.system.building.build_modal",
}
INTERPOLATION = {"type": "string", "pattern": r"\$\{"}
# Lines of a file of conf/.
ENTRY_LINE = re.compile(r"(?P<indent> *)(?P<name>\w+):(?:\s+(?P<value>[^#\s].*?|\"#.*?))??(?:\s+#\s?(?P<comment>.*))?$")
COMMENT = re.compile(r" *#\s?(?P<comment>.*)$")
# What the file is made of, rather than what it sets.
STRUCTURE = ("defaults", "hydra", "_target_", "_convert_", "_partial_", "_recursive_", "kind")


@dataclass(frozen=True)
class Setting:
    """An entry of a file: its name within the file, `sensors.force`, its default as written, and what is said of it."""

    name: str
    default: str
    meaning: str


@dataclass
class SettingsFile:
    """A file of conf/: the comment on top, the class it chooses, and its settings."""

    title: str = ""
    commands: list[str] = field(default_factory=list)
    target: str = ""
    settings: list[Setting] = field(default_factory=list)


def explained(file: Path) -> SettingsFile:
    """What a file of conf/ says, comments included, which a YAML parser leaves out."""
    settings_file, skipped = SettingsFile(), -1
    path: list[tuple[int, str]] = []
    top: list[str] = []
    for line in file.read_text(encoding="utf-8").splitlines():
        entry, comment = ENTRY_LINE.fullmatch(line), COMMENT.fullmatch(line)
        if entry:
            depth = len(entry["indent"])
            if -1 < skipped < depth:
                continue
            skipped = -1
            path = [(indent, name) for indent, name in path if indent < depth] + [(depth, entry["name"])]
            if entry["name"] == "_target_" and depth == 0:
                settings_file.target = entry["value"]
            if entry["name"] in STRUCTURE:
                skipped = depth
                continue
            name = ".".join(name for _, name in path)
            settings_file.settings.append(Setting(name, entry["value"] or "", entry["comment"] or ""))
        elif comment and not settings_file.settings and not path:
            top.append(comment["comment"])
        elif comment and settings_file.settings and skipped == -1 and line.startswith("  "):
            last = settings_file.settings[-1]
            settings_file.settings[-1] = replace(last, meaning=f"{last.meaning} {comment['comment'].strip()}".strip())
    settings_file.commands = [line.strip() for line in top if line.startswith("  ")]
    settings_file.title = " ".join(line for line in top if not line.startswith("  ") and not line.startswith("@"))
    return settings_file


def json_schema(config_dir: str | None = None) -> Schema:
    """The schema of a file for `--config`, and of an experiment; a folder may have more options.

    Raises:
        InputError: One of its files cannot be read, or chooses a class that is not registered.
    """
    main, meanings, _ = _file("", "config", None)
    groups = {name: list(option_names(name, config_dir)) for name in NODES}
    properties = {
        name: _setting(value, _hint(RunConfig, name), name, meanings)
        for name, value in main.items()
        if name not in (*NODES, *STRUCTURE)
    }
    for name, options in groups.items():
        if options:
            files = [(option, *_file(name, option, config_dir)) for option in options]
            chosen = [_option(name, node, said, f"{name}={option}: {title}") for option, node, said, title in files]
            properties[name] = {"anyOf": [{"enum": options}, *chosen]}
        else:
            part_meanings = {key.removeprefix(f"{name}."): text for key, text in meanings.items()}
            properties[name] = _option(name, main[name], part_meanings, "")
    experiment: Schema = {"enum": list(option_names("experiment", config_dir))}
    properties["experiment"] = {"anyOf": [experiment, {"type": "array", "items": experiment}]}
    dotted: dict[str, list[Schema]] = {}
    for name in NODES:
        for key, schema in _within(name, properties[name]):
            if schema not in dotted.setdefault(key, []):
                dotted[key].append(schema)
    free = "|".join(key.replace(".", r"\.") for key, schemas in dotted.items() if any(map(_has_parts, schemas)))
    choices = {f"override /{name}": {"enum": options} for name, options in groups.items() if options}
    entry = {"type": "object", "properties": choices}
    return {
        "$schema": DRAFT,
        "title": "Settings of pinn-run",
        "type": "object",
        "properties": {
            "defaults": {"type": "array", "items": {"anyOf": [{"type": "string"}, entry]}},
            **properties,
            **{key: schemas[0] if len(schemas) == 1 else {"anyOf": schemas} for key, schemas in dotted.items()},
        },
        "patternProperties": {r"^hydra([./]|$)": {}, rf"^({free})\.": {}},
        "additionalProperties": False,
    }


def _file(group: str, option: str, config_dir: str | None) -> tuple[dict[str, Any], dict[str, str], str]:
    """What the files of an option set, what they say of each setting, and the title of its own."""
    node: dict[str, Any] = {}
    meanings: dict[str, str] = {}
    title = ""
    for file in reversed(files_of(group, option, config_dir)):
        said, settings = explained(file), OmegaConf.to_container(read_yaml(file), resolve=False)
        node.update(settings)  # type: ignore[arg-type]
        meanings |= {setting.name: setting.meaning for setting in said.settings}
        title = said.title
    return node, meanings, title


def _option(group: str, node: Mapping[str, Any], meanings: Mapping[str, str], title: str) -> Schema:
    """The settings of one option of a group."""
    made_by = MADE_BY.get(f"{group} {node.get('kind')}") or MADE_BY.get(group)
    if "_target_" in node:
        check_registered(group, made_by := node["_target_"])
    return {**_object(node, _imported(made_by), group, "", meanings), **({"description": title} if title else {})}


def _object(node: Mapping[str, Any], maker: Any, group: str, within: str, meanings: Mapping[str, str]) -> Schema:
    """A mapping with these entries and no others; of a user's own class there may be more that Hydra reads."""
    properties = {}
    for key, value in node.items():
        path = f"{within}{key}"
        if key in STRUCTURE:
            continue
        if isinstance(value, Mapping) and "_target_" in value:
            check_registered(group, value["_target_"])
            properties[key] = _object(value, _imported(value["_target_"]), group, f"{path}.", meanings)
        else:
            properties[key] = _setting(value, _hint(maker, key), path, meanings)
    return {
        "type": "object", "properties": properties, "patternProperties": {"^_": {}}, "additionalProperties": False,
    }  # fmt: skip


def _setting(value: Any, hint: Any, path: str, meanings: Mapping[str, str]) -> Schema:
    """One setting: its type, what its file says of it, and its default."""
    schema = _of_type(hint) if hint is not None else _like(value)
    if schema:
        alternatives = list(schema.get("anyOf", [schema]))
        if isinstance(value, Mapping):  # of which there may be other entries
            alternatives = [
                {**alternative, "properties": {
                    key: _setting(part, hint and alternative["additionalProperties"], f"{path}.{key}", meanings)
                    for key, part in value.items()
                }} if "additionalProperties" in alternative else alternative
                for alternative in alternatives
            ]  # fmt: skip
        schema = {"anyOf": [*alternatives, *([{"type": "null"}] if value is None else []), INTERPOLATION]}
    meaning = meanings.get(path)
    return {**schema, **({"description": meaning} if meaning else {}), "default": value}


def _like(value: Any) -> Schema:
    """Of a setting that nobody annotates: what its default is like; a number may be null."""
    if isinstance(value, bool):
        return {"type": "boolean"}
    return {"type": ["number", "null"]} if isinstance(value, int | float) else {}


def _of_type(hint: Any) -> Schema:
    """The schema of an annotation; of one that says nothing of use it allows anything."""
    if isinstance(hint, dict):  # which is a schema already
        return hint
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        allowed = hint.__metadata__[0]
        return allowed if isinstance(allowed, dict) else {"enum": list(allowed)}
    if origin is Literal:
        return {"enum": list(arguments)}
    if origin in (Union, types.UnionType):
        parts = [_of_type(argument) for argument in arguments]
        return {"anyOf": parts} if all(parts) else {}
    if origin is not None and issubclass(origin, Mapping):
        return {"type": "object", "additionalProperties": _of_type(arguments[1])}
    if origin is not None and issubclass(origin, Sequence):
        # DOFs may be called by names.
        items = {"type": ["integer", "string"]} if arguments[0] is int else _of_type(arguments[0])
        return {"type": "array", "items": items}
    return {"type": PLAIN[hint]} if hint in PLAIN else {}


def _hint(maker: Any, name: str) -> Any:
    """The annotation of what a class or a function takes under a name; None where there is none that can be read."""
    places = [
        (vars(c).get("__annotations__", {}), vars(sys.modules[c.__module__])) for c in getattr(maker, "__mro__", ())
    ]
    function: Callable[..., Any] | None = maker.__init__ if inspect.isclass(maker) else maker
    if function is not None:
        parameters = inspect.signature(function).parameters
        rest = (p for p in parameters.values() if p.kind is inspect.Parameter.VAR_KEYWORD)
        parameter = parameters.get(name) or next(rest, None)
        annotation = {} if parameter is None else {name: parameter.annotation}
        places.insert(0, (annotation, getattr(function, "__globals__", {})))
    for annotated, scope in places:
        if name in annotated:
            try:
                holder = types.SimpleNamespace(__annotations__={name: annotated[name]})
                return get_type_hints(holder, scope, include_extras=True)[name]
            except NameError:  # it is imported for the type checker alone, or by another module
                continue
    return None


def _imported(name: str | None) -> Any:
    """The class or the function of a dotted name; None of one that needs a package which is not installed."""
    module, _, attribute = (name or "").rpartition(".")
    try:
        return getattr(importlib.import_module(module), attribute) if module else None
    except ModuleNotFoundError:
        return None


def _within(name: str, schema: Schema) -> Iterator[tuple[str, Schema]]:
    """Every setting in the schema of a group, by its full name."""
    for alternative in schema.get("anyOf", [schema]):
        for key, part in alternative.get("properties", {}).items():
            yield f"{name}.{key}", part
            yield from _within(f"{name}.{key}", part)


def _has_parts(schema: Schema) -> bool:
    """Whether a setting may be a mapping with entries of the user's own."""
    alternatives = schema.get("anyOf", [schema])
    return any("additionalProperties" in part or not {"type", "enum"} & part.keys() for part in alternatives)
