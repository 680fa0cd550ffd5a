"""Which parameters are unknown, as a user says it by names and patterns, and how far the others are believed."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from pinn_cli.record.record import Record
from pinn_cli.settings.errors import InputError, suggestion
from pinn_cli.settings.legal_values import entries, is_finite_number
from pinn_cli.system.damping import WHOLE
from pinn_cli.system.incidence import Incidence
from pinn_cli.system.parameters import LINEAR_UNITS, MASS, Parameter
from pinn_cli.system.structure import Structure

# Kinds that cannot be negative unless the user says otherwise, beside those of which their law says so.
POSITIVE = ("m", "c", "k", "kappa", "mu", "A", "n", "F_c", "factor", *WHOLE)
# Instead of names: what the structure has no value for.
MISSING = "missing"
# In a message.
NAMES_SHOWN = 16
# Of a standard deviation over the value: beyond it nothing is believed, and sums lose their last digits.
LARGEST_UNCERTAINTY = 1000


def all_names(structure: Structure) -> dict[str, Parameter]:
    """``k_2`` to the parameter of that name, for every one of the chain, in its order."""
    return {parameter.name: parameter for parameter in structure.every_parameter()}


def unknown_parameters(
    structure: Structure, records: Sequence[Record], unknown: str | Sequence[str] | None, forces_free: bool = True
) -> list[Parameter]:
    """The unknown parameters, in the chain's order.

    Args:
        structure: The prescribed model.
        records: What the estimator sees of it; a sensor in any of them is one.
        unknown: Names (``k_1``) and patterns (``k_*``, ``*_2``, ``k_[1-3]``), one or a list; None: the stiffness and
            the nonlinear parameters of every connection that ends at a DOF without a sensor. Of a chain: connection i
            if DOF i has none (paper, section 4.2). Of a finite-element model: of every connection that was added to it,
            and the factors of its parts. `MISSING`: whatever the structure has no value for.
        forces_free: Whether forces that nobody measured are whatever the motion takes; else they are processes, and
            equations of motion hold under them too.

    Raises:
        InputError: A name that does not exist, nothing at all, or a parameter that no equation of motion contains.
    """
    names = all_names(structure)
    # What is said of the whole's damping without a value is unknown without another word.
    of_whole = {name for name, p in names.items() if p.kind in WHOLE and math.isnan(p.prescribed)}
    if unknown is None:
        hidden = _hidden_connections(structure, np.any([each.observed for each in records], axis=0))
        chosen = {
            name
            for name, p in names.items()
            if p.kind not in (MASS, "c", *WHOLE) and hidden[structure.members[p.kind][p.index]]
        }
        if not chosen | of_whole:
            raise InputError("scheme.unknown", None, "names such as [k_1, c_3]", "every DOF has a sensor")
    elif unknown == MISSING:
        chosen = {name for name, p in names.items() if math.isnan(p.prescribed)}
        if not chosen:
            raise InputError("scheme.unknown", MISSING, "used with a structure that lacks values", "all are given")
    else:
        patterns = [unknown] if isinstance(unknown, str) else entries(unknown)
        chosen = {name for pattern in patterns for name in _matching(pattern, structure, names, "scheme.unknown")}
        if not chosen:
            raise InputError("scheme.unknown", unknown, "null, or at least one name such as k_2")
    parameters = [parameter for name, parameter in names.items() if name in chosen | of_whole]
    for parameter in parameters:
        _check_touched(parameter, structure, records, forces_free)
    return parameters


def _hidden_connections(structure: Structure, observed: np.ndarray) -> np.ndarray:
    """(C,) bool: those that end at a DOF without a sensor; of a chain DOF i counts as the end of connection i alone."""
    stretch = structure.incidence.matrix[: len(structure.parameters["k"])]
    if structure.is_modal:  # the modes come first, and no sensor measures them
        stretch = structure.incidence.matrix
        return np.arange(stretch.shape[0]) >= structure.groups[0].incidence.shape[0]
    if stretch.shape[0] == stretch.shape[1] and (stretch != Incidence.chain(structure.ndof).matrix).nnz == 0:
        return ~observed
    hidden: np.ndarray = abs(stretch) @ ~observed > 0
    return hidden


def _matching(pattern: Any, structure: Structure, names: Mapping[str, Parameter], setting: str) -> list[str]:
    """Names that a name or a pattern means. ``k_*`` means every k and no k_2: what stands before the _ is a kind."""
    if isinstance(pattern, str) and pattern in names:
        return [pattern]
    matches = []
    if isinstance(pattern, str):
        kinds = [kind for kind in structure.parameters if pattern.startswith(f"{kind}_")]
        matches = [
            name
            for name, p in names.items()
            if (p.kind in kinds and fnmatchcase(name, pattern) and fnmatchcase(p.whose, pattern[len(p.kind) + 1 :]))
            or (not kinds and fnmatchcase(name, pattern))
        ]
    if not matches:
        if structure.labels.connections:
            shown = ", ".join([*list(names)[:NAMES_SHOWN], *(["..."] if len(names) > NAMES_SHOWN else [])])
            allowed, hint = f"one of {shown}", suggestion(str(pattern), names)
        else:
            allowed = f"one of {', '.join(structure.parameters)} with _1 to _{structure.ndof}"
            hint = f"the estimator's model is a {structure.nonlinearity_name} chain"
        raise InputError(setting, pattern, f"{allowed}, or a pattern such as k_* (any connection)", hint)
    return matches


def _check_touched(parameter: Parameter, structure: Structure, records: Sequence[Record], forces_free: bool) -> None:
    """A parameter is in the equations of motion of the DOFs at its connection's ends; a mass in that of its own DOF."""
    if structure.is_modal:
        if parameter.kind == MASS:
            allowed, hint = "parameters of connections", "the mass of a mode is one: its shape holds its size"
            raise InputError("scheme.unknown", parameter.name, allowed, hint)
        return
    enforced = np.any([record.unforced | record.sensors("force") for record in records], axis=0)
    if forces_free and not enforced[structure.ends(parameter)].any():
        hint = "the forces on the DOFs at its ends are unknown, so nothing says what it is"
        raise InputError("scheme.unknown", parameter.name, "parameters that an equation of motion contains", hint)
    if parameter.kind != MASS:
        return
    jumps = [record for record in records if record.intersample == "zero_order_hold"]
    if any(r.sensors("force")[parameter.index] and r.sensors("acceleration")[parameter.index] for r in jumps):
        allowed = "another parameter, or a record whose force is not held between samples"
        hint = "a held force makes that DOF's measured acceleration jump by an amount that needs its mass"
        raise InputError("scheme.unknown", parameter.name, allowed, hint)


def initial_values(
    structure: Structure, given: Mapping[str, float | None] | None, positive: Sequence[str]
) -> dict[Parameter, float]:
    """Where unknown parameters start, for those that the user says something about: kind, name or pattern to value.

    Later entries overrule earlier ones; of ``positive`` kinds none can be negative.

    Raises:
        InputError: A name that does not exist, no number, or a value that violates the kind's constraint.
    """
    out = {}
    for key, value in (given or {}).items():
        if value is None:
            continue
        setting = f"scheme.initial.{key}"
        if not is_finite_number(value):
            raise InputError(setting, value, "a finite number, or null: from the record")
        for parameter in parameters_called(key, structure, setting):
            kind = parameter.kind
            if (kind in positive and value < 0) or (kind == MASS and value == 0):
                why = f"scheme.positive=[{', '.join(positive)}] keeps {kind} from falling below zero"
                raise InputError(setting, value, "> 0" if kind == MASS else ">= 0", why)
            out[parameter] = float(value)
    return out


def parameters_called(key: str, structure: Structure, setting: str) -> list[Parameter]:
    """The parameters that a kind (``k``: all connections), a name or a pattern means, in the structure's order.

    None, for a kind that this chain lacks and another nonlinearity has.

    Raises:
        InputError: Naming ``setting``: there is no such parameter.
    """
    if key in (*LINEAR_UNITS, "kappa", "mu") and key not in structure.parameters:
        return []
    names = all_names(structure)
    if key in structure.parameters and key not in names:
        return [parameter for parameter in names.values() if parameter.kind == key]
    return [names[name] for name in _matching(key, structure, names, setting)]


def checked_positive(positive: Any) -> tuple[str, ...] | None:
    """``scheme.positive`` as a tuple of kinds; None: see :func:`positive_kinds`.

    Raises:
        InputError: It is no list of words.
    """
    if positive is None:
        return None
    kinds = entries(positive)
    is_list = isinstance(positive, Sequence) and not isinstance(positive, str)
    if not is_list or not all(isinstance(kind, str) for kind in kinds):
        raise InputError("scheme.positive", positive, "null, or a list of kinds of parameters, such as [m, c, k]")
    return tuple(kinds)


def positive_kinds(structure: Structure, said: Sequence[str] | None) -> Sequence[str]:
    """Kinds of parameters that cannot be negative: those that are said, else `POSITIVE` and what every law says.

    Beyond zero a law can have solutions that make no sense, such as a stiffness that degrades below nothing.
    """
    of_laws = (kind for law in structure.laws for kind in law.nonnegative)
    return tuple(dict.fromkeys((*POSITIVE, *of_laws))) if said is None else said


def check_used(
    structure: Structure,
    unknown: Collection[Parameter],
    given: Mapping[str, float | None] | None,
    positive: Sequence[str] | None,
) -> None:
    """Refuse what a user says about parameters, by ``scheme.initial`` and ``scheme.positive``, and would not be used.

    Raises:
        InputError: A kind that no law has, or a start of parameters that are not unknown.
    """
    kinds = (*LINEAR_UNITS, *structure.parameters, *POSITIVE)
    for kind in positive or ():
        if kind not in kinds:
            allowed = f"a list of kinds of parameters: {', '.join(dict.fromkeys(kinds))}"
            raise InputError("scheme.positive", f"[{', '.join(positive or ())}]", allowed, f"no connection has {kind}")
    for key, value in (given or {}).items():
        called = [] if value is None else parameters_called(key, structure, f"scheme.initial.{key}")
        if called and not set(called) & set(unknown):
            hint = f"{called[0].name} is prescribed; add it to scheme.unknown to have it estimated"
            raise InputError(f"scheme.initial.{key}", value, "of an unknown parameter", hint)


def checked_uncertainty(value: Any) -> float:
    """``scheme.parameter_uncertainty`` as a number.

    Raises:
        InputError: It is none, negative, or so large that nothing is believed.
    """
    if not is_finite_number(value) or not 0 <= value <= LARGEST_UNCERTAINTY:
        allowed = f"a number between 0 and {LARGEST_UNCERTAINTY}"
        raise InputError("scheme.parameter_uncertainty", value, allowed, "0 holds the parameters fixed")
    return float(value)


def believed_parameters(
    structure: Structure, uncertainty: float, but: Collection[Parameter] = ()
) -> tuple[Parameter, ...]:
    """Every parameter of a chain ``but`` some and its masses, with a relative prior standard deviation; 0 fixes all."""
    return tuple(
        replace(parameter, prior_std=uncertainty * abs(parameter.prescribed))
        for parameter in structure.every_parameter()
        if parameter.kind != MASS and parameter not in but and uncertainty * parameter.prescribed != 0
    )
