"""``model.npz``: arrays and one text of JSON, nothing that is executed when it is read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields, replace
from io import BytesIO
from pathlib import Path
from typing import Any, TypedDict, TypeVar

import numpy as np

from pinn_cli.model.knowledge import DiscrepancyEvidence, EndState, Levels, Misfit, Model, ParameterKnowledge
from pinn_cli.model.structure_content import structure_content, structure_of
from pinn_cli.runs.reading import NUMBER, DamagedError, check_layout, checked, read_arrays, stamp
from pinn_cli.runs.resume import RESULT, read_record
from pinn_cli.runs.writing import write_bytes
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.paths import located

P = TypeVar("P")
NAME, SETTING = "model.npz", "model"
ALLOWED = "null, or the directory of a finished run"
# Of the file's layout; those before had less.
FORMAT = 2
# Of a parameter, what the structure itself does not say; and of what the record needed, numbers.
_OWN, _LEVELS = ("unknown", "positive"), ("discrepancy", "step", "force", "features")
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
    words, structure = structure_content(model.structure)
    words |= {
        **stamp(FORMAT),
        "parameters": [[p.kind, p.index, *(bool(getattr(p, name)) for name in _OWN)] for p in model.parameters],
        "verdict": model.verdict,
        "reason": model.reason,
    }
    parts = {
        "structure": structure,
        "sigma": model.levels.sensors,
        "level": {name: getattr(model.levels, name) for name in _LEVELS},
        "parameters": _attributes(model.known),
        "told": _attributes(model.levels.windows),
        "end": _attributes(model.end),
        "misfit": _attributes(model.misfit),
    }
    arrays = {f"{part}_{name}": np.asarray(x) for part, held in parts.items() for name, x in held.items()}
    if model.draws is not None:
        arrays["draws"] = model.draws
    arrays["content"] = np.frombuffer(json.dumps(words, allow_nan=False).encode(), dtype=np.uint8)
    content = BytesIO()
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
    if "configuration" not in read_record(directory):
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
    file = directory / NAME
    arrays = read_arrays(file)
    try:
        words = json.loads(bytes(arrays.pop("content")).decode())
        check_layout({NUMBER: words.get("version", 1)} | words, FORMAT, file, oldest=FORMAT)
        return _model(checked(words, ModelFile), arrays, directory)
    except InputError:
        raise
    except Exception as error:  # of arrays, texts and structures that may be anything
        reason = str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"
        raise DamagedError(file, reason) from error


def _model(words: ModelFile, arrays: Mapping[str, np.ndarray], directory: Path) -> Model:
    for name, values in arrays.items():
        if values.dtype.kind not in "biuf" or (name.startswith(_KNOWN) and not np.isfinite(values).all()):
            raise ValueError(f"{name} holds other things than numbers")
    structure = structure_of(words, _part("structure", arrays))
    known = ParameterKnowledge(**_fields("parameters", arrays))
    told, end = _made(DiscrepancyEvidence, "told", arrays), _made(EndState, "end", arrays)
    misfit = _made(Misfit, "misfit", arrays)
    count = len(words["parameters"])
    own = (known.mean, known.told, known.weight, known.first_std, known.prescribed)
    vectors = [values for values in own if values is not None]
    if {values.shape for values in vectors} != {(count,)} or known.covariance.shape != (count, count):
        raise ValueError(f"its {count} parameters have arrays of other sizes")
    history = None if misfit is None else misfit.history
    if history is not None and (history.ndim != 2 or history.shape[1] != structure.coordinates or len(history) < 2):
        raise ValueError("the force that it leaves out is none of its coordinates")
    parameters = tuple(
        replace(
            structure.parameter(str(kind), int(index)), prescribed=float(mean), prior_std=float(std),
            unknown=bool(unknown), positive=bool(positive),
        )
        for (kind, index, unknown, positive), mean, std in zip(
            words["parameters"], known.mean, known.first_std, strict=True
        )
    )  # fmt: skip
    discrepancy, step, force, features = (arrays[f"level_{name}"].item() for name in _LEVELS)
    levels = Levels(_part("sigma", arrays), discrepancy, step, force, features, told)
    verdict, reason, draws = words["verdict"], words["reason"], arrays.get("draws")
    return Model(structure, parameters, known, levels, end, verdict, reason, draws, directory, misfit)


def _attributes(part: Any) -> dict[str, Any]:
    """Of a dataclass of numbers and arrays, without those that are None; nothing of None."""
    held = {} if part is None else {field.name: getattr(part, field.name) for field in fields(part)}
    return {name: value for name, value in held.items() if value is not None}


def _part(name: str, arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {key.removeprefix(f"{name}_"): values for key, values in arrays.items() if key.startswith(f"{name}_")}


def _fields(name: str, arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """What :func:`_attributes` gave: a value by itself is a number."""
    return {key: values if values.ndim else values.item() for key, values in _part(name, arrays).items()}


def _made(kind: type[P], name: str, arrays: Mapping[str, np.ndarray]) -> P | None:
    held = _fields(name, arrays)
    return kind(**held) if held else None
