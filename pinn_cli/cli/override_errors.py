"""What Hydra and OmegaConf say about a bad command line or config file, said in one line that a user can act on."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from pinn_cli.cli.help import option_names, options_with, setting_names
from pinn_cli.cli.options import SUBCOMMANDS
from pinn_cli.settings.errors import InputError, suggestion
from pinn_cli.settings.override_syntax import setting_of

if TYPE_CHECKING:
    from collections.abc import Iterator

# What no word of Hydra's grammar may have unless it is quoted.
_NEEDS_QUOTES = re.compile(r"[^\w/\-\\+.$%*@?|:=,\[\]{}() ]|[^\x00-\x7f]")
# More brackets in brackets than any setting has.
DEEPEST = 50


def explain(
    error: BaseException, overrides: Sequence[str], config_dir: str | None, composing: bool
) -> InputError | None:
    """The input error behind an exception of Hydra's or OmegaConf's, or None if it is something else.

    Args:
        error: What was raised while the configuration was composed or a job was started.
        overrides: The command line's overrides (`system.ndof=3`), to name the value that was given.
        config_dir: The folder given by `--config-dir`, whose settings and options count as known.
        composing: Whether no job had started: then every error that Hydra raises on purpose is about its input.
    """
    for cause in _chain(error):
        if isinstance(cause, InputError):
            return cause
    if isinstance(error, MissingConfigException):
        return _unknown_option(error, config_dir)
    if isinstance(error, OverrideParseException):
        return _bad_syntax(error, overrides)
    for cause in _chain(error):
        key = getattr(cause, "full_key", None)
        if key and "not in struct" in str(cause):
            return _unknown_setting(str(key), overrides, config_dir)
        if key and isinstance(cause, OmegaConfBaseException):
            for override in overrides:  # case=${nothing}
                if "${" in override:
                    name, _, value = override.partition("=")
                    return InputError(setting_of(name), value, "resolvable", _first_line(cause))
            return InputError(key, _given(str(key), overrides), "of the type that Hydra expects", _first_line(cause))
    if composing and isinstance(error, RecursionError):
        return _too_deep(overrides, config_dir)
    meant = isinstance(error, HydraException | OmegaConfBaseException | YAMLError)
    # Hydra raises a KeyError of a variable that hydra.job.env_copy names and that is not set.
    return _in_its_words(error, overrides) if meant or (composing and type(error) in (KeyError, ValueError)) else None


def _chain(error: BaseException) -> Iterator[BaseException]:
    current: BaseException | None = error
    while current is not None:
        yield current
        current = current.__cause__ or current.__context__


def _unknown_option(error: MissingConfigException, config_dir: str | None) -> InputError:
    """`system=duffin`: the group exists, the option does not."""
    group, _, option = (error.missing_cfg_file or "").rpartition("/")
    # experiment=paper/x is told as group experiment/paper; a user types and reads it from the first folder on.
    root, _, folder = group.partition("/")
    if root == "hydra":  # no group of its own, but a folder of groups, whose options Hydra's plug-ins have
        root, given, options = group, option, sorted(error.options or ())
    else:
        given, options = f"{folder}/{option}" if folder else option, sorted(option_names(root, config_dir))
    if given in options:
        return InputError(root, given, "such that a configuration follows", _first_line(error))
    return InputError(root, given, f"one of {', '.join(options)}", suggestion(given, options))


def _bad_syntax(error: OverrideParseException, overrides: Sequence[str]) -> InputError:
    """`system.ndof=[1` or a word without an equals sign."""
    name, equals, value = error.override.partition("=")
    if not equals:
        spaced = error.override in overrides[1:]
        hint = "a value with spaces needs quotes inside quotes: 'data.path=\"my rig.csv\"'" if spaced else ""
        hint = suggestion(error.override, SUBCOMMANDS) or hint
        if Path(error.override).is_file():
            hint = (
                f"pinn-run inspect {shlex.quote(error.override)} looks at a record; --config takes a file of settings"
            )
        return InputError("override", error.override, "of the form setting=value", hint)
    hint = "brackets, braces and commas need quotes for the shell"
    depth = sum(value.count(bracket) for bracket in "[{(") - sum(value.count(bracket) for bracket in "]})")
    strange = _NEEDS_QUOTES.findall(value)
    if depth:
        hint = f"{abs(depth)} closing bracket(s) too {'few' if depth > 0 else 'many'}; {hint}"
    elif "'" in value or '"' in value:
        hint = f"quotes go around the whole value, within others for the shell: '{name}=\"...\"'"
    elif strange:
        hint = f"the character {strange[0]} needs quotes inside quotes: '{name}=\"{value}\"'"
    return InputError(name, value, "a number, a word, a list [1,2] or a mapping {a:1}", hint)


def _too_deep(overrides: Sequence[str], config_dir: str | None) -> InputError:
    """Composing that never ends, or a value of brackets in brackets."""
    deepest = max(overrides, key=lambda override: override.count("[") + override.count("{"), default="")
    if deepest.count("[") + deepest.count("{") > DEEPEST:
        name, _, value = deepest.partition("=")
        return InputError(name, f"{value[:20]}...", f"nested in at most {DEEPEST} levels")
    hint = f"the defaults lists of files in {config_dir} include each other in a circle" if config_dir else ""
    return InputError("overrides", " ".join(overrides) or "(none)", "such that a configuration follows", hint)


def _unknown_setting(key: str, overrides: Sequence[str], config_dir: str | None) -> InputError:
    """`system.ndfo=3` or `sytem=linear`: no such setting; name the likeliest one, and those beside it."""
    name = next((n for n in map(setting_of, overrides) if n == key or n.startswith(f"{key}.")), key)
    kept = [override for override in overrides if setting_of(override) != name and not override.startswith("hydra.")]
    settings = setting_names(kept, config_dir)
    siblings = [other for other in settings if other.rpartition(".")[0] == name.rpartition(".")[0]]
    allowed = f"one of the settings {', '.join(siblings)}" if siblings else "a setting that pinn-run --cfg job lists"
    owners = options_with(name)
    hint = f"it belongs to {', '.join(owners)}" if owners else suggestion(name, settings)
    return InputError(name, _given(name, overrides), allowed, hint)


def _in_its_words(error: BaseException, overrides: Sequence[str]) -> InputError:
    """Whatever else: Hydra's own words, in one line."""
    text = _first_line(error)
    ambiguous = re.search(r"Ambiguous value for argument '([^=]+)=(.*)'", text)
    if ambiguous:
        hint = f"add --multirun to sweep, or brackets for a list: [{ambiguous[2]}]"
        return InputError(ambiguous[1], ambiguous[2], "one value", hint)
    doubled = re.search(r"Multiple values for ([\w/]+)\.", text)
    if doubled:
        hint = f"write {doubled[1]}=... without a plus sign"
        return InputError(doubled[1], _given(doubled[1], overrides), "chosen once", hint)
    return InputError("overrides", " ".join(overrides) or "(none)", "such that a configuration follows", str(error))


def _given(key: str, overrides: Sequence[str]) -> str:
    return next((o.partition("=")[2] for o in overrides if setting_of(o) == key), "(from a config file)")


def _first_line(error: BaseException) -> str:
    return str(error).strip().partition("\n")[0]
