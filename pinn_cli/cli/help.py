"""What there is to choose from: names of options and settings, for `pinn-run --help` and for errors.

What Hydra and OmegaConf say about a bad command line or config file is said in one line that a user can act on. Names
are read from the files: Hydra would go through all its configs for the same, which takes half a second.
"""

from __future__ import annotations

import re
import shlex
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from pinn_cli.cli.options import SUBCOMMANDS
from pinn_cli.settings.errors import InputError, suggestion
from pinn_cli.settings.instantiation import CONF
from pinn_cli.settings.override_syntax import setting_of
from pinn_cli.settings.yaml_file import read_yaml

HELP_WIDTH = 120
# Options of a group that are shown at once.
_MOST_SHOWN = 12
# Errors about the command line or a file that no code of ours has found.
MEANT = (HydraException, OmegaConfBaseException, YAMLError)

_BEFORE = """\
pinn-run: the response of a structural chain where there is no sensor, its parameters, and how far to trust both

usage: pinn-run [inspect FILE | modes FILE | follow | population RUN ...] [GROUP=OPTION ...] [SETTING=VALUE ...]

Examples
  pinn-run                                             6-DOF Duffing chain, sensors on DOFs 1 and 2, SNR 50 dB
  pinn-run system.ndof=20 noise.snr_db=20              a longer chain, more noise
  pinn-run experiment=paper/sr_6dof_perturbed          a row of the paper's tables
  pinn-run data=csv data.path=rig.csv system.ndof=3 system.m=5    your own record; `pinn-run data=csv --cfg job` lists
    its settings; or data=mat, uff, parquet, tdms, hdf5, netcdf, excel (docs/how-to/own-record.md)
  pinn-run inspect rig.csv                             look at a record first: gaps, noise, natural frequencies, a
    command to go on with
  pinn-run modes rig.csv                               natural frequencies, damping ratios and shapes, without a model
    (docs/how-to/modes.md)
  pinn-run follow data=csv data.path=rig.csv data.window=60 ...    a record that is still being measured
    (docs/how-to/follow.md)
  pinn-run population outputs/sweeps/SWEEP             runs of similar structures together: what is usual, and what not
    (docs/how-to/population.md)
  pinn-run baseline=kalman_smoother                    the same problem by a Kalman smoother, in the same tables
  pinn-run --multirun noise.snr_db=50,20,10 'seed=range(10)'    a sweep; the same command again goes on with it
  pinn-run --multirun hydra/launcher=joblib 'seed=range(10)'    on all cores; pinn-run collect=SWEEP: what there is so
    far
  pinn-run --multirun experiment=search/spline         settings by a score without truth (docs/how-to/search.md)
  pinn-run tracking=mlflow                             a record of all runs to browse; or tensorboard
    (docs/how-to/tracking.md)
  pinn-run resume=outputs/CASE/DATE_TIME               go on with a run that was interrupted or killed

Groups and their options
"""

_AFTER = """
Settings (`pinn-run --cfg job` prints them with every value; each is explained in its file under conf/)
  case seed device threads resume figures report.{export,between}
  system.{ndof,m,c,k,kappa,mu}                         a number, or one per connection: system.k=[10,10,8]
  simulation.{duration,samples,hold,method} noise.{snr_db,seeds} excitation.{band,rms,dofs,seed}
  scheme.{unobserved_fraction,unobserved,parameter_uncertainty} validation.dofs

Options
  --cfg job            print the settings that a command would run with
  --multirun, -m       run every combination of comma-separated values
  --help GROUP         the options of a group, or one (--help network=mlp), with their settings
  --config FILE        settings of this command in a file (YAML); what is typed goes before them
  --config-dir DIR     add configs of your own: DIR/experiment/my_rig.yaml is then experiment=my_rig
  --quiet, -q          print errors and the last line alone
  --json               print one JSON object at the end: directory, verdict, reasons, parameters
  --json-schema        print what a file of settings may say, for editors that complete and check YAML
  --version            print the version
  --shell-completion install=bash    print what makes the Tab key complete settings (also zsh, fish)
  --hydra-help         the options of Hydra, which reads the configuration

Results are written to outputs/CASE/DATE_TIME, a sweep's to outputs/sweeps/SETTINGS_DIGEST; the last line printed is
    that path.
"""


def option_names(group: str, config_dir: str | None = None) -> Iterator[str]:
    """Every option of a group, in its folders too (`paper/sr_6dof_snr50`); a leading underscore marks no option."""
    for place in _places(config_dir):
        for file in sorted((place / group).rglob("*.yaml")):
            if not file.name.startswith("_"):
                yield file.relative_to(place / group).with_suffix("").as_posix()


def group_names(config_dir: str | None = None) -> list[str]:
    """Every group that is not one of Hydra's, in alphabetical order."""
    folders = {folder.name for place in _places(config_dir) for folder in place.iterdir() if folder.is_dir()}
    return sorted(name for name in folders if name != "hydra" and next(option_names(name, config_dir), None))


def files_of(group: str, option: str, config_dir: str | None = None) -> list[Path]:
    """The file of an option of a group, and behind it those of the group that it is based on."""
    places = (place / group / f"{option}.yaml" for place in _places(config_dir))
    file = next(filter(Path.is_file, places), None)
    if file is None:  # as of _self_
        return []
    bases = [base for base in _plain(read_yaml(file)).get("defaults") or () if isinstance(base, str)]
    return [file, *(below for base in bases for below in files_of(group, base, config_dir))]


def options_with(setting: str) -> list[str]:
    """The choices that have a setting: `data.path` is a setting of `data=csv`."""
    group, _, key = setting.partition(".")
    options = option_names(group) if key and group not in ("experiment", "hydra") else ()
    files = ((option, file) for option in options for file in files_of(group, option))
    return list(dict.fromkeys(f"{group}={option}" for option, file in files if key in _names(_plain(read_yaml(file)))))


def setting_names(overrides: Sequence[str], config_dir: str | None = None) -> list[str]:
    """All settings and groups as a user types them, under these overrides, or by default if they do not compose."""
    from pinn_cli.cli.composing import compose_config  # not for --help

    try:
        config = compose_config(overrides, config_dir)
    except (HydraException, OmegaConfBaseException, ValueError):
        config = compose_config([], config_dir)
    return [*_names(_plain(config)), "experiment"]


def _places(config_dir: str | None) -> list[Path]:
    return [CONF, *([Path(config_dir)] if config_dir else [])]


def _plain(config: Any) -> Any:
    return OmegaConf.to_container(config, resolve=False)


def _names(node: Any, prefix: str = "") -> Iterator[str]:
    for key, value in node.items():
        if not str(key).startswith("_"):
            yield f"{prefix}{key}"
            if isinstance(value, dict):
                yield from _names(value, f"{prefix}{key}.")


def help_text(config_dir: str | None = None, asked: Sequence[str] = ()) -> str:
    """The help, its long lines folded; or that of groups and options, `network` and `network=mlp`: their files.

    A folder of more configs has its options listed too.

    Raises:
        InputError: There is no such group or option.
    """
    if asked:
        return "\n\n".join(_help_of(word, config_dir) for word in asked)
    groups = [f"{group}: {', '.join(option_names(group, config_dir))}" for group in group_names(config_dir)]
    lines = [*_BEFORE.splitlines(), *groups, *_AFTER.splitlines()]
    return "\n".join(textwrap.fill(line, HELP_WIDTH, subsequent_indent=" " * 4, break_on_hyphens=False)
                     if len(line) > HELP_WIDTH else line for line in lines)  # fmt: skip


def _help_of(word: str, config_dir: str | None) -> str:
    """The files of a group's options, which explain every setting."""
    name, _, chosen = word.partition("=")
    group, _, setting = name.partition(".")
    chosen = "" if setting else chosen
    names = group_names(config_dir)
    if group not in names:
        raise InputError("--help", group, f"a group: {', '.join(names)}", suggestion(group, names))
    all_options = list(option_names(group, config_dir))
    options = [name for name in all_options if chosen in ("", name)]
    if not options:
        raise InputError(group, chosen, f"one of {', '.join(all_options)}", suggestion(chosen, all_options))
    if len(options) > _MOST_SHOWN:
        return f"{group}: {', '.join(options)}\n`pinn-run --help {group}={options[0]}` shows one of them."
    return "\n\n".join(f"--- {group}={option}\n{_shown(group, option, config_dir)}" for option in options)


def _shown(group: str, option: str, config_dir: str | None) -> str:
    """Text of an option's files, without what only Hydra reads."""
    files = files_of(group, option, config_dir)
    lines = (line for file in files for line in file.read_text(encoding="utf-8").splitlines() if line.strip())
    return "\n".join(line for line in lines if not re.match(r"\s*_target_:|defaults:|  - |# @package", line))


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
        return _bad_syntax(error)
    for cause in _chain(error):
        key = str(getattr(cause, "full_key", None) or "")
        if key and "not in struct" in str(cause):
            return _unknown_setting(key, overrides, config_dir)
        if key and isinstance(cause, OmegaConfBaseException):
            name = next((setting_of(override) for override in overrides if "${" in override), key)
            return InputError(name, _given(name, overrides), "a value that can be used there", _first_line(cause))
    if composing and isinstance(error, RecursionError):
        error = HydraException("values are nested too deeply, or files include each other in a circle")
    # Hydra raises a KeyError of a variable that hydra.job.env_copy names and that is not set.
    if not (isinstance(error, MEANT) or (composing and type(error) in (KeyError, ValueError))):
        return None
    ambiguous = re.search(r"Ambiguous value for argument '([^=]+)=(.*)'", _first_line(error))
    if ambiguous:
        hint = f"add --multirun to sweep, or brackets for a list: [{ambiguous[2]}]"
        return InputError(ambiguous[1], ambiguous[2], "one value", hint)
    return InputError("overrides", " ".join(overrides) or "(none)", "such that a configuration follows", str(error))


def _chain(error: BaseException) -> Iterator[BaseException]:
    current: BaseException | None = error
    while current is not None:
        yield current
        current = current.__cause__ or current.__context__


def _unknown_option(error: MissingConfigException, config_dir: str | None) -> InputError:
    """`system=duffin`: the group exists, the option does not."""
    group, _, option = (error.missing_cfg_file or "").rpartition("/")
    options = sorted(error.options or ())
    # experiment=paper/x is told as group experiment/paper; a user types and reads it from the first folder on.
    root, _, folder = group.partition("/")
    if root != "hydra":
        group, option = root, f"{folder}/{option}" if folder else option
        options = sorted(option_names(root, config_dir))
    return InputError(group, option, f"one of {', '.join(options)}", suggestion(option, options) or _first_line(error))


def _bad_syntax(error: OverrideParseException) -> InputError:
    """`system.ndof=[1` or a word without an equals sign."""
    name, equals, value = error.override.partition("=")
    if equals:
        hint = f"brackets, braces and commas need quotes for the shell, other signs and spaces two: '{name}=\"...\"'"
        return InputError(name, value, "a number, a word, a list [1,2] or a mapping {a:1}", hint)
    hint = suggestion(name, SUBCOMMANDS) or "a value with spaces needs quotes inside quotes: 'data.path=\"my rig.csv\"'"
    if Path(name).is_file():
        hint = f"pinn-run inspect {shlex.quote(name)} looks at a record; --config takes a file of settings"
    return InputError("override", name, "of the form setting=value", hint)


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


def _given(key: str, overrides: Sequence[str]) -> str:
    return next((o.partition("=")[2] for o in overrides if setting_of(o) == key), "(from a config file)")


def _first_line(error: BaseException) -> str:
    return str(error).strip().partition("\n")[0]
