"""Causes where stiffnesses are unknown, so that neither the prescribed chain nor a misled estimate can tell them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.verdict.channel import channels
from pinn_cli.verdict.channel_faults import channel_faults, swap_finding
from pinn_cli.verdict.comparison import comparisons
from pinn_cli.verdict.finding import Finding
from pinn_cli.verdict.prediction import is_linear, predicted
from pinn_cli.verdict.refit import refitted
from pinn_cli.verdict.time_unit import UNITS, unit_finding

if TYPE_CHECKING:
    from pinn_cli.record.record import Record
    from pinn_cli.scheme.problem import Problem
    from pinn_cli.system.chain import Chain
    from pinn_cli.verdict.refit import Place

# Free stiffnesses can make up for much: a cause must leave less than where the chain is prescribed, and this many times
# less than the fit without it; a gain 15 % off leaves 0.02 where two channels disagree.
LEFT, BETTER, GAIN_BETTER = 0.05, 4.0, 1.5
# Pairs of sensors that are tried in each other's place, a second each.
MOST_PAIRS = 10
LEAST_FACTOR = 1.3


def refit_causes(problem: Problem, excused: Sequence[str]) -> list[Finding]:
    """The one channel, mass or unit of time without which a chain with free stiffnesses does what was measured.

    Args:
        problem: Some of whose stiffnesses are unknown; without any there is nothing to refit. A nonlinear chain's
            spectra are not those of a linear one, and masses would be blamed for the difference.
        excused: Names of channels whose fault is known already.
    """
    record = problem.record
    free = [(p.kind, p.index) for p in problem.uncertain if p.unknown and p.kind == "k"]
    if not free or not is_linear(problem.chain) or not np.isfinite(record.force).all():
        return []
    as_given = _misfit(refitted(problem.chain, record, free, excused, levels=True), record, excused)
    found = [_channel(problem.chain, record, free, excused, as_given)]
    if as_given > LEFT:
        found.append(_time_unit(problem.chain, record, free, excused, as_given))
        if found == [None, None]:
            found.append(_exchanged(problem.chain, record, free, excused, as_given))
        if found[1] is None and found[-1] is None:
            found += [_mass(problem.chain, record, free, dof, excused, as_given) for dof in range(problem.chain.ndof)]
    causes = [cause for cause in found if cause is not None]
    return [min(causes, key=lambda cause: cause.left)] if causes else []


def _channel(
    chain: Chain, record: Record, free: Sequence[Place], excused: Sequence[str], as_given: float
) -> Finding | None:
    fitted = refitted(chain, record, free, excused, levels=False)
    prediction = None if fitted is None else predicted(fitted, record)
    faults = [] if prediction is None else channel_faults(prediction, excused)
    if (
        prediction is None
        or len(faults) != 1
        or faults[0].left > min(LEFT, as_given / GAIN_BETTER)
        or faults[0].kind == "sensor"
    ):
        return None
    named = faults[0].text
    others = [
        c.misfit for c in comparisons(prediction) if c.channel.name not in excused and c.channel.name not in named
    ]
    if faults[0].kind != "swap" and max(others, default=0.0) > LEFT:
        return None
    return faults[0]


def _time_unit(
    chain: Chain, record: Record, free: Sequence[Place], excused: Sequence[str], as_given: float
) -> Finding | None:
    for seconds in UNITS:
        scaled = replace(record, time=record.time * seconds)
        left = _misfit(refitted(chain, scaled, free, excused, levels=True), scaled, excused)
        if left <= min(LEFT, as_given / BETTER):
            return unit_finding(seconds, left)
    return None


def _exchanged(
    chain: Chain, record: Record, free: Sequence[Place], excused: Sequence[str], as_given: float
) -> Finding | None:
    """Two sensors of one kind, with the columns of which swapped the fit is better than with those of any others."""
    seen = [c for c in channels(record) if c.name not in excused]
    pairs = [(a, b) for a, b in combinations(seen, 2) if a.quantity == b.quantity]
    best: Finding | None = None
    for a, b in pairs if len(pairs) <= MOST_PAIRS else []:
        values = getattr(record, a.quantity).copy()
        values[:, [a.dof, b.dof]] = values[:, [b.dof, a.dof]]
        swapped = replace(record, **{a.quantity: values})
        left = _misfit(refitted(chain, swapped, free, excused, levels=True), swapped, excused)
        if left <= min(LEFT, as_given / BETTER, best.left if best else np.inf):
            best = swap_finding(a, b, left)
    return best


def _mass(
    chain: Chain, record: Record, free: Sequence[Place], dof: int, excused: Sequence[str], as_given: float
) -> Finding | None:
    fitted = refitted(chain, record, [*free, ("m", dof)], excused, levels=True)
    left = _misfit(fitted, record, excused)
    if fitted is None or left > min(LEFT, as_given / BETTER):
        return None
    value = float(fitted.parameters["m"][dof])
    factor = value / float(chain.parameters["m"][dof])
    if 1 / LEAST_FACTOR < factor < LEAST_FACTOR:
        return None
    name = f"m_{dof + 1}"
    reason = f"with {name} = {value:.4g} kg, {factor:.3g} times what is prescribed, a chain does what was measured"
    return Finding("mass", name, f"{reason}; check system.m", left=left)


def _misfit(chain: Chain | None, record: Record, excused: Sequence[str]) -> float:
    """The largest NMSE of any channel; infinite without a prediction."""
    prediction = None if chain is None else predicted(chain, record)
    if prediction is None:
        return np.inf
    misfits = [c.misfit for c in comparisons(prediction) if c.channel.name not in excused]
    return max(misfits) if misfits and np.isfinite(misfits).all() else np.inf
