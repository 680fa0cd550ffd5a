"""From what a user writes of ``system`` to a structure: chains, laws by their names, damping, modes to be found."""

from __future__ import annotations

import importlib
import inspect
import math
import pkgutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import torch
from omegaconf import OmegaConf
from scipy.sparse import csr_matrix

from pinn_cli.settings.errors import InputError, suggestion
from pinn_cli.settings.instantiation import construct, plugins_of
from pinn_cli.settings.legal_values import USABLE, entries, is_finite_number, is_usable_number, whole_number
from pinn_cli.system import connection
from pinn_cli.system.connection.linear import Linear
from pinn_cli.system.connection.nonlinearity import Nonlinearity
from pinn_cli.system.connection_groups import ConnectionGroup
from pinn_cli.system.damping import OF_MASS, OF_STIFFNESS, RATIO, StructuralDamping
from pinn_cli.system.incidence import Incidence
from pinn_cli.system.parameters import LINEAR_UNITS, MASS, Labels
from pinn_cli.system.shapes import Shapes
from pinn_cli.system.structure import Structure

# What an estimator holds grows with the square of this number;
# `pinn_cli.training.normal_matrix.layout` counts it for a record.
MOST_DOFS = 2000
DAMPING = "system.damping"
DAMPING_ALLOWED = "{ratio: 0.02}, {ratio: [0.02, 0.015]} (by mode), or {rayleigh: [a_0, a_1]} (1/s, s); null is unknown"
# More modes in one band are not told apart.
MOST_MODES = 40
# The support that does not move, as connections name it.
FIXED_GROUND = "ground"
_NAME = "a name: letters, digits and _, a letter first"


def chain_of(parameters: dict[str, torch.Tensor], nonlinearity: Nonlinearity) -> Structure:
    """Masses in a row; connection i joins DOF i-1 to DOF i, the first one the ground to DOF 1.

    Its elongations are e_i = u_i - u_{i-1} with u_0 = 0, so the equation of motion of DOF i is
    m_i a_i + r_i - r_{i+1} = f_i with r_{n+1} = 0 (paper, section 2). Parameters are "m", "c", "k" and those of the
    nonlinearity, each (ndof,).

    Raises:
        ValueError: The names or the shapes of the parameters do not fit.
    """
    ndof = parameters[MASS].shape[-1] if MASS in parameters else 1
    return Structure(parameters, (ConnectionGroup(nonlinearity, Incidence.chain(ndof)),))


def build_chain(
    ndof: int,
    nonlinearity: Nonlinearity,
    damping: Mapping[str, Any] | None = None,
    **parameters: float | Sequence[float],
) -> Structure:
    """A chain from numbers (the same for every connection) or lists of ndof numbers.

    They are m (kg), c (N s/m), k (N/m) and those of the nonlinearity, as kappa (N/m^3). Beside damping of the whole,
    see :func:`damped`, c is 0 unless given.

    Raises:
        InputError: Naming ``system.<parameter>``: ndof is no positive integer; a parameter is missing, unknown, of the
            wrong length, not finite or of a sign that makes no sense.
    """
    nonlinearity = _with_given(nonlinearity, parameters)
    names = (*LINEAR_UNITS, *nonlinearity.parameters)
    for name in names:
        if parameters.get(name) is None and (name != "c" or damping is None):
            allowed = f"given: a {nonlinearity.name} chain has {', '.join(names)}"
            raise InputError(f"system.{name}", "nothing", allowed)
    structure = build_partial_chain(ndof, nonlinearity, damping, **parameters)
    for name, tensor in structure.parameters.items():
        if tensor.isnan().any():
            allowed = "given in every entry: null is for what is unknown of a record"
            raise InputError(f"system.{name}", parameters.get(name, damping), allowed)
    return structure


def build_partial_chain(
    ndof: int,
    nonlinearity: Nonlinearity,
    damping: Mapping[str, Any] | None = None,
    **parameters: float | Sequence[float | None] | None,
) -> Structure:
    """The same where a value may be missing, None or left out, alone or in a list: it is NaN in the chain.

    Of a measured structure nobody knows all; :func:`pinn_cli.scheme.scheme.check_given` sees to it that only
    what is to be estimated is missing.
    """
    ndof = whole_number("system.ndof", ndof, least=1, most=MOST_DOFS)
    nonlinearity = _with_given(nonlinearity, parameters)
    names = (*LINEAR_UNITS, *nonlinearity.parameters)
    for name, value in parameters.items():
        if name not in names and (value is not None or name not in nonlinearity.optional):
            raise InputError(f"system.{name}", value, f"left out: a {nonlinearity.name} chain has {', '.join(names)}")
    if damping is not None and parameters.get("c") is None:
        parameters["c"] = 0.0
    values = {name: _per_connection(name, parameters.get(name), ndof) for name in names}
    _check_signs(values, nonlinearity)
    tensors = {name: torch.tensor(value, dtype=torch.float64) for name, value in values.items()}
    return damped(chain_of(tensors, nonlinearity), damping)


def _with_given(nonlinearity: Nonlinearity, parameters: Mapping[str, Any]) -> Nonlinearity:
    return nonlinearity.of_given([name for name, value in parameters.items() if value is not None])


def _per_connection(name: str, value: Any, ndof: int) -> list[float]:
    if isinstance(value, np.ndarray | torch.Tensor):
        value = value.tolist()
    numbers = [value] * ndof if value is None or is_finite_number(value) else entries(value)
    if not numbers or not all(number is None or is_finite_number(number) for number in numbers):
        raise InputError(f"system.{name}", value, f"a finite number or a list of {ndof} finite numbers")
    for number in numbers:
        if number is not None and not is_usable_number(number):
            raise InputError(f"system.{name}", number, f"0 or {USABLE}")
    if len(numbers) != ndof:
        allowed = f"a number or a list of {ndof} numbers (system.ndof={ndof})"
        raise InputError(f"system.{name}", list(numbers), allowed, f"it has {len(numbers)}")
    return [math.nan if number is None else float(number) for number in numbers]


def _check_signs(values: dict[str, list[float]], nonlinearity: Nonlinearity) -> None:
    least = {
        name: min((number for number in row if not math.isnan(number)), default=1.0) for name, row in values.items()
    }
    if least["m"] <= 0.0:
        raise InputError("system.m", least["m"], "> 0", "a DOF without mass has no equation of motion")
    for name in nonlinearity.nonnegative:
        if least.get(name, 0.0) < 0.0:  # a law may be without some
            raise InputError(f"system.{name}", least[name], ">= 0", "the connection would push itself apart")


def damped(structure: Structure, damping: Any) -> Structure:
    """A structure with damping of the whole beside the dampers of its connections.

    Args:
        structure: Without it.
        damping: ``{ratio: x}`` of every mode, ``{ratio: [x, y]}`` mode by mode, where the last one is that of all modes
            that follow, or ``{rayleigh: [a_0, a_1]}``; an entry that is null is NaN in the structure. None: none.

    Raises:
        InputError: Naming ``system.damping``.
    """
    if damping is None:
        return structure
    if not isinstance(damping, Mapping) or len(damping) != 1 or next(iter(damping)) not in ("ratio", "rayleigh"):
        raise InputError(DAMPING, damping, DAMPING_ALLOWED)
    ((form, given),) = damping.items()
    if form == "ratio":
        return _with(structure, RATIO, _ratios(given, structure))
    values = entries(given)
    if len(values) != 2 or not all(x is None or (is_usable_number(x) and x >= 0) for x in values):
        raise InputError(f"{DAMPING}.rayleigh", given, "two numbers >= 0, [a_0, a_1] in 1/s and s, or null")
    for kind, value in zip((OF_MASS, OF_STIFFNESS), values, strict=True):
        structure = _with(structure, kind, [math.nan if value is None else float(value)])
    return structure


def _ratios(given: Any, structure: Structure) -> list[float]:
    values = [given] if given is None or is_finite_number(given) else entries(given)
    modes = structure.coordinates - structure.shapes.residual
    if not 1 <= len(values) <= modes or not all(x is None or (is_finite_number(x) and 0 <= x < 1) for x in values):
        allowed = f"a number from 0 to below 1, or a list of at most {modes}, one for each mode"
        raise InputError(f"{DAMPING}.ratio", given, allowed, "0.02 is two per cent; null is unknown")
    return [math.nan if x is None else float(x) for x in values]


def _with(structure: Structure, kind: str, values: list[float]) -> Structure:
    """The structure with such dampers behind its connections; of springs of one where a stiffness is unknown."""
    law, before = StructuralDamping(kind), structure.incidence.matrix
    mass = np.nan_to_num(structure.parameters_like(np.empty(0))[MASS], nan=1.0)
    rows = law.rows(mass, before, np.ones(before.shape[0]))
    group = ConnectionGroup(law, Incidence(csr_matrix((0, before.shape[1]))), tuple(range(len(values)))).of_rows(rows)
    parameters = {**structure.parameters, kind: torch.tensor(values, dtype=torch.float64)}
    return replace(structure, parameters=parameters, groups=(*structure.groups, group)).present()


def law_settings(name: Any, setting: str) -> tuple[str, ...]:
    """Names of the settings that a law has beside its parameters.

    Raises:
        InputError: Naming ``setting``: there is no such law.
    """
    return tuple(inspect.signature(_law(name, setting)).parameters)


def law_called(name: Any, settings: Mapping[str, Any], setting: str) -> Nonlinearity:
    """The law of a connection: ``duffing``, or what follows ``system.`` in the name of a plug-in's entry point.

    Messages name the connection by ``setting``, as a user types it.

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
    laws = _shipped()
    if isinstance(name, str) and name in laws:
        return laws[name]
    # A package that is installed beside this one declares its laws: `"system.rubber" = "my_laws.rubber:Rubber"`.
    plugins = plugins_of("system")
    names = [*laws, *plugins]
    if not isinstance(name, str) or name not in plugins:
        raise InputError(setting, name, f"one of {', '.join(names)}", suggestion(str(name), names))
    return plugins[name].load()


@cache
def _shipped() -> dict[str, type[Nonlinearity]]:
    """Name to class, of every law that has a file."""
    files = [
        importlib.import_module(f"{connection.__name__}.{m.name}") for m in pkgutil.iter_modules(connection.__path__)
    ]
    classes = [member for file in files for _, member in inspect.getmembers(file, inspect.isclass)]
    return {law.name: law for law in classes if issubclass(law, Nonlinearity) and not inspect.isabstract(law)}


@dataclass(frozen=True)
class ModesSought:
    """Which modes a record is asked for.

    Attributes:
        count: In the band; None: as many as the record shows.
        starts: Hz, where they are looked for; empty: wherever they are.
    """

    count: int | None = None
    starts: tuple[float, ...] = ()

    @classmethod
    def of(cls, modes: Any) -> ModesSought:
        """From ``system.modes``.

        Raises:
            InputError: It is no number of modes, and no list of frequencies.
        """
        if modes is None:
            return cls()
        if is_finite_number(modes):
            return cls(whole_number("system.modes", modes, least=1, most=MOST_MODES))
        given = entries(modes) if isinstance(modes, Sequence) and not isinstance(modes, str) else []
        if not given or len(given) > MOST_MODES or not all(is_finite_number(x) and x > 0 for x in given):
            allowed = "null (as many as the record shows), a number of modes, or a list of frequencies in Hz"
            raise InputError("system.modes", modes, allowed)
        return cls(len(given), tuple(sorted(float(x) for x in given)))


def build_modal(
    dofs: Sequence[str] | int | None = None, modes: Any = None, kind: str = "modal", measured: Sequence[str | int] = ()
) -> Structure:
    """A structure whose modes a record has yet to tell: one coordinate without a value.

    Args:
        dofs: Names of the measured points, or how many there are; None: those that a record's settings name.
        modes: See :class:`ModesSought`.
        kind: The name of the config group's choice.
        measured: DOFs with a force or a sensor, by name or by number from 1.

    Raises:
        InputError: Naming ``system.dofs`` or ``system.modes``.
    """
    ModesSought.of(modes)
    if dofs is None:
        names = tuple(dict.fromkeys(dof for dof in measured if isinstance(dof, str) and not dof.isdecimal()))
        count = max([len(names), *(int(dof) for dof in measured if str(dof).isdecimal())])
        if not count or (names and count > len(names)):
            raise InputError("system.dofs", None, "given: names of the measured points, such as [root, tip]")
    elif is_finite_number(dofs):
        names, count = (), whole_number("system.dofs", dofs, least=1)
    else:
        names = checked_names(entries(dofs))
        count = len(names)
    nothing = np.full(1, np.nan)
    return modal_structure(names, np.ones((count, 1)), (nothing, nothing, nothing), (0, 0))


def modal_structure(
    dofs: tuple[str, ...],
    shapes: np.ndarray,
    values: tuple[np.ndarray, np.ndarray, np.ndarray],
    outside: tuple[int, int],
) -> Structure:
    """A structure of modes, those of the band first, then those below it and those above, so many of each ``outside``.

    Shapes (dofs, n) are how far every DOF moves with every mode; values are modal masses, kg, damping, N s/m, and
    stiffnesses, N/m, each (n,). DOFs without names go by their numbers.
    """
    n, (below, above) = shapes.shape[1], outside
    within = n - below - above
    names = [f"mode_{i + 1}" for i in range(within)]
    names += [f"below_{i + 1}" for i in range(below)] + [f"above_{i + 1}" for i in range(above)]
    m, c, k = (torch.tensor(np.asarray(x, dtype=float)) for x in values)
    return Structure(
        {MASS: m, "c": c, "k": k},
        (ConnectionGroup(Linear(), Incidence(csr_matrix(np.eye(n)))),),
        Labels(dofs, tuple(names), tuple(names)),
        mode_shapes=Shapes(shapes, None, csr_matrix((0, len(shapes))), above, below),
    )


def checked_names(dofs: Any) -> tuple[str, ...]:
    """Names of coordinates.

    Raises:
        InputError: Naming ``system.dofs``: there are none, or they are no names, or clash.
    """
    names = entries(dofs)
    if not names:
        raise InputError("system.dofs", dofs, "a list of names of coordinates", "e.g. system.dofs=[x1, x2]")
    for i, name in enumerate(names):
        check_name("system.dofs", name)
        if name == FIXED_GROUND:
            raise InputError("system.dofs", name, "another name", "the ground is the support, which has no coordinate")
        if name in names[:i]:
            raise InputError("system.dofs", name, "there once only")
    return tuple(names)


def check_name(setting: str, name: Any) -> None:
    """See that something can be called by a name.

    Raises:
        InputError: Naming ``setting``: it cannot.
    """
    if not isinstance(name, str) or not name.isidentifier():
        hint = "YAML reads yes, no, on and off as true and false: put it in quotes" if isinstance(name, bool) else ""
        raise InputError(setting, name, _NAME, hint)
