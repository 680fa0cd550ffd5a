"""``model.npz``: arrays and one text of JSON, nothing that is executed when it is read."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from dataclasses import fields, replace
from io import BytesIO
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from pinn_cli.model.knowledge import DiscrepancyEvidence, EndState, Levels, Misfit, ParameterKnowledge
from pinn_cli.model.model import Model
from pinn_cli.model.structure_content import structure_content, structure_of
from pinn_cli.runs.reading import MOST_BYTES, NUMBER, DamagedError, check_layout, check_regular, checked, stamp
from pinn_cli.runs.resume import RESULT, read_record
from pinn_cli.runs.writing import write_bytes
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.paths import located
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.structure import Structure

NAME, SETTING = "model.npz", "model"
ALLOWED = "null, or the directory of a finished run"
# Of the file's layout; those before had less.
FORMAT = 2
# Of the arrays when unpacked: a file that somebody made to be far larger than it looks is not read.
MOST_UNPACKED = 16 * MOST_BYTES
# Of a parameter, what the structure itself does not say.
_OWN = ("unknown", "positive")
# Of what the record needed, numbers.
LEVELS = ("discrepancy", "step", "force", "features")
# Arrays that have no gaps, by how their names begin.
_KNOWN = ("structure_", "parameters_mean", "parameters_told", "parameters_weight", "end_", "misfit_", "draws")


class ModelFile(TypedDict):
    """Words of the file."""

    parameters: list[list[Any]]
    verdict: str
    reason: str
    groups: list[dict[str, Any]]
    kinds: list[str]


def write_model(model: Model, directory: Path) -> Path:
    """Write ``model.npz`` into a run's directory, whole or not at all."""
    words, arrays = structure_content(model.structure)
    words |= {
        **stamp(FORMAT),
        "parameters": [[p.kind, p.index, *(bool(getattr(p, name)) for name in _OWN)] for p in model.parameters],
        "verdict": model.verdict,
        "reason": model.reason,
    }
    arrays = {f"structure_{name}": values for name, values in arrays.items()}
    arrays |= _arrays("parameters_", model.known)
    arrays |= {f"sigma_{quantity}": np.asarray(values) for quantity, values in model.levels.sensors.items()}
    arrays |= {f"level_{name}": np.array(getattr(model.levels, name)) for name in LEVELS}
    arrays |= _arrays("told_", model.levels.windows) | _arrays("end_", model.end) | _arrays("misfit_", model.misfit)
    if model.draws is not None:
        arrays["draws"] = model.draws
    content = BytesIO()
    arrays["content"] = np.frombuffer(json.dumps(words, allow_nan=False).encode(), dtype=np.uint8)
    np.savez_compressed(content, **arrays)  # type: ignore[arg-type]
    return write_bytes(content.getbuffer(), directory / NAME)


def read_model(given: Any, base: Path | None = None) -> Model:
    """The model of a finished run.

    Args:
        given: Its directory, as a user names it.
        base: The folder that a relative path starts from; None: the current one.

    Raises:
        InputError: There is no such run, it has not finished, its verdict is that it failed, or its file is damaged.
    """
    if not isinstance(given, str) or not given:
        raise InputError(SETTING, given, ALLOWED)
    directory = located(given, base)
    if not directory.is_dir():
        raise InputError(SETTING, given, ALLOWED, "there is no such directory")
    record = read_record(directory)
    if "configuration" not in record:
        sweep = (directory / "multirun.yaml").is_file()
        began = (directory / ".hydra").is_dir()
        unfinished = "the run in it has not finished: pinn-run resume=... goes on with it"
        hint = "it is a sweep's: name one of its jobs" if sweep else unfinished if began else f"it has no {RESULT}"
        raise InputError(SETTING, given, ALLOWED, hint)
    if not (directory / NAME).is_file():
        raise InputError(SETTING, given, ALLOWED, f"it has no {NAME}: it is a prediction, or of an earlier release")
    try:
        model = stored_model(directory)
    except DamagedError as error:
        raise InputError(SETTING, given, ALLOWED, f"{error}") from error
    if model.verdict == "failed":
        hint = f"the verdict on that run is failed: {model.reason}"
        raise InputError(SETTING, given, "a run whose verdict is not failed", hint)
    return model


def stored_model(directory: Path) -> Model:
    """What lies in a directory as ``model.npz``, whatever else does.

    Raises:
        InputError: A later release wrote it.
        DamagedError: It is not as it was written.
    """
    try:
        return _read(directory)
    except InputError:
        raise
    except Exception as error:  # of archives, arrays, texts and structures that may be anything
        reason = str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
        raise DamagedError(directory / NAME, reason) from error


def _read(directory: Path) -> Model:
    file = directory / NAME
    check_regular(file, MOST_UNPACKED)
    with zipfile.ZipFile(file) as archive:
        if sum(member.file_size for member in archive.infolist()) > MOST_UNPACKED:
            raise ValueError("it is larger than any model")
    with np.load(file, allow_pickle=False) as content:
        arrays = {name: content[name] for name in content.files}
    words = json.loads(bytes(arrays.pop("content")).decode())
    check_layout({NUMBER: words.get("version", 1)} | words, FORMAT, file, oldest=FORMAT)
    words = checked(words, ModelFile)
    for name, values in arrays.items():
        if values.dtype.kind not in "biuf" or (name.startswith(_KNOWN) and not np.isfinite(values).all()):
            raise ValueError(f"{name} holds other things than numbers")
    structure = structure_of(words, _of("structure_", arrays))
    known = ParameterKnowledge(**_fields("parameters_", arrays))
    _check(known, len(words["parameters"]))
    means = zip(words["parameters"], known.mean, known.first_std, strict=True)
    parameters = tuple(_parameter(structure, own, mean, std) for own, mean, std in means)
    windows, end, misfit = (_fields(prefix, arrays) for prefix in ("told_", "end_", "misfit_"))
    discrepancy, step, force, features = (arrays[f"level_{name}"].item() for name in LEVELS)
    told = DiscrepancyEvidence(**windows) if windows else None
    levels = Levels(_of("sigma_", arrays), discrepancy, step, force, features, told)
    if misfit:
        _check_history(misfit["history"], structure.coordinates)
    return Model(
        structure,
        parameters,
        known,
        levels,
        EndState(**end) if end else None,
        str(words["verdict"]),
        str(words["reason"]),
        arrays.get("draws"),
        directory,
        misfit=Misfit(**misfit) if misfit else None,
    )


def _arrays(prefix: str, part: Any) -> dict[str, np.ndarray]:
    """What a dataclass of numbers and arrays holds, by its fields' names after a prefix; nothing of None."""
    if part is None:
        return {}
    held = {field.name: getattr(part, field.name) for field in fields(part)}
    return {f"{prefix}{name}": np.asarray(value) for name, value in held.items() if value is not None}


def _fields(prefix: str, arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """What :func:`_arrays` wrote."""
    return {name: values if values.ndim else values.item() for name, values in _of(prefix, arrays).items()}


def _check_history(history: np.ndarray, coordinates: int) -> None:
    if history.ndim != 2 or history.shape[1] != coordinates or len(history) < 2 or not np.isfinite(history).all():
        raise ValueError("the force that it leaves out is none of its coordinates")


def _check(known: ParameterKnowledge, count: int) -> None:
    shapes = {(count,)} if count else {(0,)}
    vectors = {values.shape for values in (known.mean, known.told, known.weight, known.first_std)}
    if known.prescribed is not None:
        vectors |= {known.prescribed.shape}
    if vectors != shapes or known.covariance.shape != (count, count):
        raise ValueError(f"its {count} parameters have arrays of other sizes")


def _parameter(structure: Structure, words: list[Any], mean: float, std: float) -> Parameter:
    kind, index, unknown, positive = words
    own = structure.parameter(str(kind), int(index))
    return replace(own, prescribed=float(mean), prior_std=float(std), unknown=bool(unknown), positive=bool(positive))


def _of(prefix: str, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name.removeprefix(prefix): values for name, values in arrays.items() if name.startswith(prefix)}
