"""``model.npz``: arrays and one text of JSON, nothing that is executed when it is read.

A run's directory holds all of its structure, as plain words and arrays, whatever files that came from.
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from io import BytesIO
from pathlib import Path
from typing import Any, TypedDict, TypeVar

import numpy as np
import torch
from scipy.sparse import csr_matrix

from pinn_cli.model.knowledge import DiscrepancyEvidence, EndState, Levels, Misfit, Model, ParameterKnowledge
from pinn_cli.runs.reading import NUMBER, DamagedError, check_layout, checked, read_arrays, stamp
from pinn_cli.runs.resume import RESULT, read_record
from pinn_cli.runs.writing import write_bytes
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.legal_values import located
from pinn_cli.system.basis import reduced_at
from pinn_cli.system.building import law_called
from pinn_cli.system.connection.nonlinearity import Nonlinearity
from pinn_cli.system.connection_groups import ConnectionGroup
from pinn_cli.system.damping import WHOLE, StructuralDamping
from pinn_cli.system.incidence import Incidence, Pairs
from pinn_cli.system.parameters import Labels
from pinn_cli.system.shapes import Shapes
from pinn_cli.system.structure import Structure
from pinn_cli.system.substructures import Substructure

P = TypeVar("P")
NAME, MODEL_SETTING = "model.npz", "model"
MODELS_ALLOWED = "null, or the directory of a finished run"
# Of the file's layout; those before had less.
MODEL_FORMAT = 2
# Of a parameter, what the structure itself does not say; and of what the record needed, numbers.
_OWN, _LEVELS = ("unknown", "positive"), ("discrepancy", "step", "force", "features")
_LABELS = ("dofs", "connections", "modes", "supports")
# Arrays that have no gaps, by how their names begin.
_KNOWN = ("structure_", "parameters_mean", "parameters_told", "parameters_weight", "end_", "misfit_", "draws")

# What the law of a finite-element model's parts is called here; no connection can be given it.
PART = "part"


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
        **stamp(MODEL_FORMAT),
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
    """The model of a finished run, whose verdict is not that it failed; arguments and errors as of `finished_model`."""
    model = finished_model(given, base)
    if model.verdict == "failed":
        hint = f"the verdict on that run is failed: {model.reason}"
        raise InputError(MODEL_SETTING, given, "a run whose verdict is not failed", hint)
    return model


def finished_model(given: Any, base: Path | None = None, without: tuple[str, ...] = ()) -> Model:
    """The model of a finished run, whatever its verdict.

    Args:
        given: Its directory, as a user names it.
        base: The folder that a relative path starts from; None: the current one.
        without: Of ``end_``, ``misfit_`` and ``draws`` those that are left unread, and are None.

    Raises:
        InputError: There is no such run, it has not finished, or its file is damaged.
    """
    if not isinstance(given, str) or not given:
        raise InputError(MODEL_SETTING, given, MODELS_ALLOWED)
    directory = located(given, base)
    if not directory.is_dir():
        raise InputError(MODEL_SETTING, given, MODELS_ALLOWED, "there is no such directory")
    if "configuration" not in read_record(directory):
        sweep = (directory / "multirun.yaml").is_file()
        began = (directory / ".hydra").is_dir()
        unfinished = "the run in it has not finished: pinn-run resume=... goes on with it"
        hint = "it is a sweep's: name one of its jobs" if sweep else unfinished if began else f"it has no {RESULT}"
        raise InputError(MODEL_SETTING, given, MODELS_ALLOWED, hint)
    if not (directory / NAME).is_file():
        hint = f"it has no {NAME}: it is a prediction, or of an earlier release"
        raise InputError(MODEL_SETTING, given, MODELS_ALLOWED, hint)
    try:
        return stored_model(directory, without)
    except DamagedError as error:
        raise InputError(MODEL_SETTING, given, MODELS_ALLOWED, f"{error}") from error


def stored_model(directory: Path, without: tuple[str, ...] = ()) -> Model:
    """What lies in a directory as ``model.npz``, whatever else does, without some arrays: see :func:`finished_model`.

    Raises:
        InputError: A later release wrote it.
        DamagedError: It is not as it was written.
    """
    file = directory / NAME
    arrays = read_arrays(file, without)
    try:
        words = json.loads(bytes(arrays.pop("content")).decode())
        check_layout({NUMBER: words.get("version", 1)} | words, MODEL_FORMAT, file, oldest=MODEL_FORMAT)
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
    windows, end = _made(DiscrepancyEvidence, "told", arrays), _made(EndState, "end", arrays)
    misfit = _made(Misfit, "misfit", arrays)
    count = len(words["parameters"])
    per_parameter = (known.mean, known.told, known.weight, known.first_std, known.prescribed)
    vectors = [values for values in per_parameter if values is not None]
    if {values.shape for values in vectors} != {(count,)} or known.covariance.shape != (count, count):
        raise ValueError(f"its {count} parameters have arrays of other sizes")
    history = None if misfit is None else misfit.history
    if history is not None and (history.ndim != 2 or history.shape[1] != structure.coordinates or len(history) < 2):
        raise ValueError("the force that it leaves out is none of its coordinates")
    parameters = []
    for (kind, index, *own), mean, std in zip(words["parameters"], known.mean, known.first_std, strict=True):
        said: dict[str, Any] = dict(zip(_OWN, map(bool, own), strict=True))
        parameter = structure.parameter(str(kind), int(index))
        parameters.append(replace(parameter, prescribed=float(mean), prior_std=float(std), **said))
    discrepancy, step, force, features = (arrays[f"level_{name}"].item() for name in _LEVELS)
    levels = Levels(_part("sigma", arrays), discrepancy, step, force, features, windows)
    verdict, reason, draws = words["verdict"], words["reason"], arrays.get("draws")
    return Model(structure, tuple(parameters), known, levels, end, verdict, reason, draws, directory, misfit)


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


def structure_content(structure: Structure) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Words and arrays that :func:`structure_of` makes the same structure of."""
    words: dict[str, Any] = {
        **{kind: list(getattr(structure.labels, kind)) for kind in _LABELS},
        "groups": [_group_words(group) for group in structure.groups],
        "kinds": list(structure.parameters),
    }
    shapes = structure.shapes if structure.is_modal else None
    if shapes is not None:
        words["residual"], words["below"] = shapes.residual, shapes.below
    if structure.pairs is not None:
        words["pairs"] = list(structure.pairs.names)
    matrices = {
        **{f"value_{kind}": values for kind, values in structure.parameters_like(np.empty(0)).items()},
        **{f"group_{number}": group.incidence.matrix for number, group in enumerate(structure.groups)},
        "influence": None if structure.influence is None else np.asarray(structure.influence, dtype=float),
        "shapes": None if shapes is None else shapes.matrix,
        "shapes_exact_at": None if shapes is None else shapes.exact_at,
        "shapes_with_ground": None if shapes is None else shapes.with_ground,
        "shapes_stretch": None if shapes is None else shapes.stretch,
        "by_supports": structure.by_supports,
        "pairs": None if structure.pairs is None else structure.pairs.weights,
    }
    arrays: dict[str, np.ndarray] = {}
    for name, matrix in matrices.items():
        if isinstance(matrix, csr_matrix):
            parts = {part: getattr(matrix, part) for part in ("data", "indices", "indptr")}
            arrays |= {f"{name}_{part}": values for part, values in (parts | {"shape": np.array(matrix.shape)}).items()}
        elif matrix is not None:
            arrays[name] = matrix
    return words, arrays


def structure_of(words: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> Structure:
    """The structure of what :func:`structure_content` gave.

    Raises:
        KeyError, ValueError, TypeError, InputError: It is no such content.
    """
    groups = tuple(
        ConnectionGroup(_law(group), Incidence(_matrix(f"group_{number}", arrays)), _parts(group))
        for number, group in enumerate(words["groups"])
    )
    labels = Labels(*(tuple(map(str, words.get(name, ()))) for name in _LABELS))
    parameters = {str(k): torch.tensor(np.asarray(arrays[f"value_{k}"], dtype=float)) for k in words["kinds"]}
    stretch, by_supports, weights = (
        _matrix(name, arrays) if f"{name}_shape" in arrays else None
        for name in ("shapes_stretch", "by_supports", "pairs")
    )
    modes = None
    if "shapes" in arrays:
        of_shapes = arrays["shapes"], arrays.get("shapes_with_ground"), stretch, int(words["residual"])
        modes = Shapes(*of_shapes, below=int(words.get("below", 0)), exact_at=arrays.get("shapes_exact_at"))
    pairs = None if weights is None else Pairs(tuple(words["pairs"]), weights)
    return Structure(parameters, groups, labels, arrays.get("influence"), modes, pairs, by_supports=by_supports)


def difference(structure: Structure, other: Structure) -> str:
    """What tells two structures apart beside the values of their parameters; "" where nothing does.

    Masses count as values: whoever simulates a change may change them.
    """
    if differs := other_dofs(structure, other):
        return differs
    if other.shapes.exact_at is not None:
        structure = reduced_at(structure, other.shapes.exact_at)
    kinds, other_kinds = ([group.kinds for group in side.groups] for side in (structure, other))
    if structure.nonlinearity_name != other.nonlinearity_name or kinds != other_kinds:
        return f"{structure.nonlinearity_name} connections, not {other.nonlinearity_name}"
    for said, found in zip(*(map(_group_words, side.groups) for side in (structure, other)), strict=True):
        # What nobody has said an estimate may choose.
        chosen = {name: None for name, value in said["settings"].items() if value is None}
        if {**found, "settings": found["settings"] | chosen} != said:
            return f"{structure.nonlinearity_name} connections of other settings"
    if structure.labels != other.labels:
        return "other names of connections"
    # Damping of the whole, which stands behind them, is in the modes of each.
    stretch, other_stretch = (
        side.stretch.matrix[: sum(g.incidence.shape[0] for g in side.groups if not g.damps_whole)]
        for side in (structure, other)
    )
    if stretch.shape != other_stretch.shape or abs(stretch - other_stretch).max() > 1e-9 * abs(other_stretch).max():
        return "other connections"
    return ""


def other_dofs(structure: Structure, other: Structure) -> str:
    """What tells the DOFs of two structures apart; "" where nothing does."""
    if structure.ndof != other.ndof:
        return f"{structure.ndof} DOFs, not {other.ndof}"
    if structure.labels.dofs != other.labels.dofs:
        return f"DOFs {', '.join(structure.labels.dofs or ('by number',))}"
    return ""


def _group_words(group: ConnectionGroup) -> dict[str, Any]:
    law = group.nonlinearity
    if isinstance(law, Substructure | StructuralDamping):
        name = PART if isinstance(law, Substructure) else law.kind
        return {"law": name, "settings": {}, "parts": list(group.parts or ())}
    settings = {name: getattr(law, name) for name in inspect.signature(type(law)).parameters if hasattr(law, name)}
    return {"law": law.name, "settings": _plain(settings), "parts": None if group.parts is None else list(group.parts)}


def _plain(value: Any) -> Any:
    """With mappings as dicts and sequences as lists."""
    if isinstance(value, Mapping):
        return {name: _plain(x) for name, x in value.items()}
    return [_plain(x) for x in value] if isinstance(value, Sequence) and not isinstance(value, str) else value


def _law(words: Mapping[str, Any]) -> Nonlinearity:
    if words["law"] in WHOLE:
        return StructuralDamping(words["law"])
    return Substructure() if words["law"] == PART else law_called(words["law"], words["settings"], "model")


def _parts(words: Mapping[str, Any]) -> tuple[int, ...] | None:
    return None if words["parts"] is None else tuple(int(part) for part in words["parts"])


def _matrix(name: str, arrays: Mapping[str, np.ndarray]) -> csr_matrix:
    data, indices, indptr, shape = (arrays[f"{name}_{part}"] for part in ("data", "indices", "indptr", "shape"))
    matrix = csr_matrix((data, indices, indptr), shape=tuple(int(x) for x in shape))
    matrix.check_format(full_check=True)  # indices beyond the shape would be read beyond the memory
    return matrix
