"""Bayesian parameter estimation: every parameter unknown, and its whole distribution (paper, section 4.3).

Priors are written as ``scheme.priors={k: {kind: gamma, shape: 2, rate: 0.1}, c_1: {kind: normal, ...}}``.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from omegaconf import OmegaConf

from pinn_cli.record.record import Record
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.problem import FREE, GAUSSIAN_PROCESS, Problem
from pinn_cli.scheme.scheme import Beginning, EstimationScheme, Sensors, Through, UnknownForce, check_given
from pinn_cli.scheme.starts import Start, Starts, calibrated
from pinn_cli.scheme.unknowns import (
    check_used,
    checked_positive,
    parameters_called,
    positive_kinds,
    unknown_parameters,
)
from pinn_cli.settings.errors import InputError, suggestion
from pinn_cli.settings.instantiation import construct
from pinn_cli.settings.legal_values import finite_number, positive_number
from pinn_cli.system.parameters import MASS, PRIOR_WIDTH, Parameter
from pinn_cli.system.priors import Gamma, HalfNormal, LogNormal, Normal, Prior
from pinn_cli.system.quantities import CALIBRATION_UNITS
from pinn_cli.system.structure import Structure

log = logging.getLogger(__name__)

PRIORS_SETTING = "scheme.priors"
# Gauss-Newton works under Gaussians this much wider than a prior that the user chose; the likelihood that it hands on
# is freed of them again. Of others it works under one as wide as the prior itself: far out lie other solutions.
GAUSSIAN_WIDTH = 100.0


def read_priors(given: Mapping[str, Any] | None, structure: Structure) -> dict[Parameter, Prior]:
    """The priors that the user chose; parameters that the user says nothing about are left out.

    Kind of parameter, name or pattern (``k``, ``k_2``, ``*_2``) to a mapping of ``kind`` and that kind's settings, or
    to null: not chosen. Later entries overrule earlier ones.

    Raises:
        InputError: Naming ``scheme.priors.<key>``: no such parameter or kind of prior, a setting that is missing,
            unknown or illegal.
    """
    priors = {}
    for key, prior in checked_priors(given).items():
        priors.update(dict.fromkeys(parameters_called(key, structure, f"{PRIORS_SETTING}.{key}"), prior))
    return priors


def checked_priors(given: Mapping[str, Any] | None) -> dict[str, Prior]:
    """The same by key, before there is a chain."""
    if given is not None and not isinstance(given, Mapping):
        raise InputError(PRIORS_SETTING, given, "a mapping such as {k: {kind: gamma, shape: 2, rate: 0.1}}")
    return {key: _prior(f"{PRIORS_SETTING}.{key}", node) for key, node in (given or {}).items() if node is not None}


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
    shown = f"gamma with {', '.join(sorted(chosen)) or 'nothing'}"
    raise InputError(place, shown, "given shape and rate, or mean and std")


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


class Bayesian(EstimationScheme):
    """Posterior distribution of all unknown parameters from the motion and force of every DOF.

    Args:
        unobserved: See :func:`pinn_cli.scheme.scheme.unobserved_dofs`.
        sensors: What an observed DOF of a simulated record has sensors for.
        unknown: See :func:`pinn_cli.scheme.unknowns.unknown_parameters`; None: everything but the masses, or of a
            finite-element model what that function says.
        priors: See :func:`pinn_cli.scheme.bayesian.read_priors`; parameters without one get a wide one on the
            record's own scale.
        positive: Kinds of parameters whose wide priors end at zero; None: see :func:`positive_kinds`.
        acceleration_through, initial_motion, unknown_force: See :class:`pinn_cli.scheme.scheme.EstimationScheme`.

    Raises:
        InputError: A setting outside its range.
    """

    name = "bayesian"

    def __init__(
        self,
        unobserved: str | Sequence[int] | None = (),
        sensors: Mapping[str, bool] | None = None,
        unknown: str | Sequence[str] | None = None,
        priors: Mapping[str, Any] | None = None,
        positive: Sequence[str] | None = None,
        acceleration_through: Through = "derivative",
        initial_motion: Beginning = FREE,
        unknown_force: UnknownForce = GAUSSIAN_PROCESS,
    ) -> None:
        chosen = Sensors.chosen(sensors, 0.0, unobserved, default=("displacement", "velocity"))
        super().__init__(chosen, acceleration_through, initial_motion, unknown_force)
        self.unknown, self.priors = unknown, priors
        checked_priors(priors)
        self.positive = checked_positive(positive)

    def pose(self, prescribed: Structure, records: Sequence[Record]) -> JointProblem:
        """See :meth:`Scheme.pose`."""
        if not prescribed.is_modal:  # of modes the record tells what their sensors show
            _check_sensors(records)
        named = self.unknown
        if named is None and not prescribed.is_modal:
            named = [f"{kind}_*" for kind in prescribed.parameters if kind != MASS]
        chosen = unknown_parameters(prescribed, records, named)
        check_given(prescribed, chosen)
        positive = positive_kinds(prescribed, self.positive)
        check_used(prescribed, chosen, None, self.positive)
        # Of a simulated structure what is prescribed would be the truth.
        given = {p: p.prescribed for p in chosen if math.isfinite(p.prescribed) and not records[0].simulated}
        (starts,) = Starts(prescribed, records, chosen, given, 1)
        records = calibrated(records, starts)
        given_priors = read_priors(self.priors, prescribed)
        stds = {p: PRIOR_WIDTH * starts[p].scale for p in chosen}
        wide = {p: HalfNormal(std) if p.kind in positive else Normal(0.0, std) for p, std in stds.items()}
        priors = {p: given_priors.get(p, wide[p]) for p in chosen}
        said = (replace(p, said=given.get(p, math.nan)) for p in chosen)
        unknown = tuple(_unknown(p, priors[p], starts[p], p in given_priors) for p in said)
        structure = prescribed.with_values({p: p.prescribed for p in unknown})
        return JointProblem.of_records(structure, records, unknown, *self.settings).changed(_with_priors)


def _unknown(parameter: Parameter, prior: Prior, start: Start, chosen_by_user: bool) -> Parameter:
    """A parameter under a Gaussian that is wider than its prior: Gauss-Newton is to find what the record says.

    Where the user has chosen the prior the parameter begins at its mean.
    """
    centre, width = prior.mean, prior.std
    chosen = chosen_by_user and np.isfinite(centre) and np.isfinite(width) and width > 0
    scale = max(start.scale, abs(centre), width) if chosen else start.scale
    first = centre if chosen and centre != 0 else start.value
    return replace(
        parameter,
        prescribed=float(first),
        prior_std=(GAUSSIAN_WIDTH if chosen else PRIOR_WIDTH) * scale,
        scale=scale,
        unknown=True,
        positive=prior.positive,
        prior=prior,
    )


def _with_priors(problem: Problem) -> Problem:
    """The problem of one record whose sensors' numbers in doubt have the prior that its channels say: a Gaussian."""
    uncertain = tuple(
        replace(p, prior=Normal(p.prescribed, p.prior_std)) if p.kind in CALIBRATION_UNITS else p
        for p in problem.uncertain
    )
    return replace(problem, uncertain=uncertain)


def _check_sensors(records: Sequence[Record]) -> None:
    """Every connection's elongation and rate must be there in one record or another, or its parameters are a guess."""
    record = records[0]
    unseen = np.flatnonzero(~np.any([each.observed for each in records], axis=0))
    if unseen.size:
        hint = "scheme=state_parameter estimates hidden motion and unknown parameters together"
        allowed = f"a sensor on every DOF, and there is none on {record.dof_names(unseen)}"
        raise InputError("scheme", "bayesian", allowed, hint)
    follows = np.any([each.sensors(quantity) for each in records for quantity in ("displacement", "velocity")], axis=0)
    for dof in np.flatnonzero(~follows):
        text = "DOF %s has an accelerometer only: drift below its noise leaves stiffness and damping poorly known"
        log.warning(text, record.dof_name(int(dof)))
