"""Priors as a user writes them: ``scheme.priors={k: {kind: gamma, shape: 2, rate: 0.1}, c_1: {kind: normal, ...}}``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from omegaconf import OmegaConf

from pinn_cli.scheme.unknowns import parameters_called
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.instantiation import construct
from pinn_cli.settings.legal_values import finite_number, positive_number
from pinn_cli.settings.suggestion import suggestion
from pinn_cli.system.parameters import PRIOR_WIDTH, Parameter
from pinn_cli.system.priors import Gamma, HalfNormal, LogNormal, Normal, Prior
from pinn_cli.system.structure import Structure

SETTING = "scheme.priors"
# Standard deviation of the priors that nobody chose, over the scale of the parameter's start.
WIDE = PRIOR_WIDTH


def read_priors(given: Mapping[str, Any] | None, structure: Structure) -> dict[Parameter, Prior]:
    """The priors that the user chose; parameters that the user says nothing about are left out.

    Args:
        given: Kind of parameter, name or pattern (``k``, ``k_2``, ``*_2``) to a mapping of ``kind`` and that kind's
            settings, or to null: not chosen. Later entries overrule earlier ones.
        structure: The prescribed model.

    Raises:
        InputError: Naming ``scheme.priors.<key>``: no such parameter or kind of prior, a setting that is missing,
            unknown or illegal.
    """
    priors = {}
    for key, prior in checked_priors(given).items():
        priors.update(dict.fromkeys(parameters_called(key, structure, f"{SETTING}.{key}"), prior))
    return priors


def checked_priors(given: Mapping[str, Any] | None) -> dict[str, Prior]:
    """The same by key, before there is a chain."""
    if given is not None and not isinstance(given, Mapping):
        raise InputError(SETTING, given, "a mapping such as {k: {kind: gamma, shape: 2, rate: 0.1}}")
    return {key: _prior(f"{SETTING}.{key}", node) for key, node in (given or {}).items() if node is not None}


def with_defaults(
    priors: Mapping[Parameter, Prior], scales: Mapping[Parameter, float], positive: Sequence[str]
) -> dict[Parameter, Prior]:
    """A prior for every unknown parameter: where none was chosen a wide one, on the scale of its start.

    Args:
        priors: Those that were chosen.
        scales: Of every unknown parameter.
        positive: Kinds of parameters that cannot be negative: HalfNormal, otherwise Normal around zero.
    """
    wide = {p: HalfNormal(WIDE * s) if p.kind in positive else Normal(0.0, WIDE * s) for p, s in scales.items()}
    return {parameter: priors.get(parameter, wide[parameter]) for parameter in scales}


def _prior(setting: str, node: Any) -> Prior:
    if not isinstance(node, Mapping):
        raise InputError(setting, node, "a mapping such as {kind: gamma, shape: 2, rate: 0.1}, or null: a wide prior")
    name = node.get("kind", "(missing)")
    if not isinstance(name, str) or name not in KINDS:
        raise InputError(f"{setting}.kind", name, f"one of {', '.join(KINDS)}", suggestion(str(name), KINDS))
    settings = OmegaConf.create({str(key): value for key, value in node.items() if key != "kind"})
    return construct(KINDS[name], settings, setting, place=setting)


def _gamma(place: str, shape: Any = None, rate: Any = None, mean: Any = None, std: Any = None) -> Gamma:
    chosen = {name for name, value in locals().items() if name != "place" and value is not None}
    if chosen == {"shape", "rate"}:
        return Gamma(positive_number(f"{place}.shape", shape), positive_number(f"{place}.rate", rate))
    if chosen == {"mean", "std"}:
        return Gamma.of_moments(positive_number(f"{place}.mean", mean), positive_number(f"{place}.std", std))
    raise InputError(
        place, f"gamma with {', '.join(sorted(chosen)) or 'nothing'}", "given shape and rate, or mean and std"
    )


def _half_normal(place: str, scale: Any) -> HalfNormal:
    return HalfNormal(positive_number(f"{place}.scale", scale))


def _log_normal(place: str, median: Any, sigma: Any) -> LogNormal:
    return LogNormal(positive_number(f"{place}.median", median), positive_number(f"{place}.sigma", sigma))


def _normal(place: str, mean: Any, std: Any) -> Normal:
    return Normal(finite_number(f"{place}.mean", mean), positive_number(f"{place}.std", std))


KINDS: dict[str, Callable[..., Prior]] = {
    "gamma": _gamma,
    "half_normal": _half_normal,
    "log_normal": _log_normal,
    "normal": _normal,
}
