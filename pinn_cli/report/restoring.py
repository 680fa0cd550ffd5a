"""What the connections whose law was sought pull with, over the elongations and the speeds that occurred."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import torch

from pinn_cli.report.estimates import Estimates, drifts
from pinn_cli.report.results import Results
from pinn_cli.system.connection.nonlinearity import OVER
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimated_structure import estimated_structure, sought_laws

CURVE_PLACES = 101  # of a curve


@dataclass(frozen=True, eq=False)
class RestoringCurve:
    """The force r of one connection, over its elongation at rest, or over its speed where it is not stretched.

    Attributes:
        connection: Its name, or its number from 1.
        over: ``elongation``, m, or ``speed``, m/s.
        at: (`CURVE_PLACES`,), from the least that occurred to the most.
        force: Of as many, N; known to be true of a simulated record.
        usual: Between which nine tenths of the samples lie, in the unit of ``at``.
    """

    connection: str
    over: str
    at: np.ndarray
    force: Estimates
    usual: tuple[float, float]


def restoring_curves(results: Results) -> list[RestoringCurve]:
    """Two for every connection without memory of whose law a parameter was unknown."""
    structure, estimate = estimated_structure(results.prescribed, results.estimate.parameters), results.estimate
    sought = sought_laws(structure, estimate.parameters)
    stretched = drifts(results.prescribed, estimate, results.truth.response)
    curves = []
    for place, connection in enumerate(structure.added.tolist()):
        if connection not in sought or structure.laws[connection].has_memory:
            continue
        elongation = stretched.of("estimate")[:, place]
        for over, history in zip(OVER, (elongation, np.gradient(elongation, stretched.time)), strict=True):
            at = np.linspace(history.min(), history.max(), CURVE_PLACES)
            low, high = np.quantile(history, (0.05, 0.95)).tolist()
            force = _force(results, structure, connection, *(at if over == other else 0.0 * at for other in OVER))
            curves.append(RestoringCurve(stretched.places[place], over, at, force, (low, high)))
    return curves


def _force(
    results: Results, structure: Structure, connection: int, elongation: np.ndarray, speed: np.ndarray
) -> Estimates:
    """What a connection of the estimated structure pulls with at elongations and speeds (L,); its force linearised."""
    estimate = results.estimate
    e, de = (torch.zeros(len(x), len(structure.laws), dtype=torch.float64) for x in (elongation, speed))
    e[:, connection], de[:, connection] = torch.as_tensor(elongation), torch.as_tensor(speed)
    slope = structure.linearise_connections(e, de, structure.parameters_like(e))
    by = np.zeros((len(elongation), len(estimate.parameters)))
    for i, p in enumerate(estimate.parameters):
        connections, members = structure.carriers.get(p.kind, (np.zeros(0), np.zeros(0)))
        index = np.flatnonzero((connections == connection) & (members == p.parameter.index))
        if index.size:
            by[:, i] = slope.by_parameter[p.kind][:, index[0]].numpy()
    has = by.any(axis=0)
    std = true = np.full(len(elongation), np.nan)
    if estimate.correlation is not None:
        spread = by[:, has] * np.array([p.std for p in estimate.parameters])[has]
        std = np.sqrt(np.einsum("li,ij,lj->l", spread, estimate.correlation[np.ix_(has, has)], spread))
    truth = results.truth.parameters
    if truth is not None and set(truth) == set(structure.parameters):
        true = results.prescribed.connection_force(e.numpy(), de.numpy(), truth)[:, connection]
    return Estimates((), slope.force[:, connection].numpy(), std, true)


def restoring_table(curves: Sequence[RestoringCurve]) -> pd.DataFrame:
    """One row per place of a curve (the content of ``restoring.csv``)."""
    return pd.concat([_rows(curve) for curve in curves], ignore_index=True)


def _rows(curve: RestoringCurve) -> pd.DataFrame:
    force, (lower, upper) = curve.force, curve.force.interval
    values = {"force": force.estimate, "std": force.std, "lower_90": lower, "upper_90": upper, "true_force": force.true}
    return pd.DataFrame({"connection": curve.connection, "over": curve.over, "at": curve.at} | values)
