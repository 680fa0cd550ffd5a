"""What the connections do: how far each is stretched, with what force, and how much energy it dissipates."""

from __future__ import annotations

import numpy as np
import pandas as pd

from pinn_cli.record.record import Truth
from pinn_cli.record.response import Response
from pinn_cli.report.estimates import Estimates, Histories, error_percent
from pinn_cli.report.results import Results
from pinn_cli.system.energy import dissipated_power, stored_by_memory, trapezoids
from pinn_cli.system.quantities import CONNECTION_FORCE
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import Estimate
from pinn_cli.training.estimated_structure import estimated_structure


def drifts(structure: Structure, estimate: Estimate, truth: Response) -> Histories:
    """Elongations of connections and, behind them, of pairs of DOFs: of a storey, its drift.

    Args:
        structure: Whose connections they are.
        estimate: Its displacements tell the drifts.
        truth: NaN where unknown: a connection is known where all that it joins are.
    """
    stretch, known = structure.drifts_of_dofs, estimate.connections
    found = _with_supports(estimate.response, structure.supports) @ stretch.T
    std = np.full(found.shape, np.nan) if known is None else known.elongation_std
    displacement = _with_supports(truth, structure.supports)
    joins = abs(stretch) @ np.isnan(displacement).any(axis=0).astype(float) > 0.0
    true = np.where(joins, np.nan, np.nan_to_num(displacement) @ stretch.T)
    names, sources = structure.drift_names, {"estimate": found, "std": std}
    own = Histories("drift", "connection", names, estimate.response.time, sources)
    return own.beside(true=true if np.isfinite(true).any() else None)


def _with_supports(response: Response, supports: int) -> np.ndarray:
    """(N, n + S), displacements of DOFs and of supports, NaN where these are not known."""
    unknown = np.full((len(response.time), supports), np.nan)
    return np.hstack((response.displacement, unknown if response.supports is None else response.supports[:, 0]))


def drift_table(drifts: Histories) -> pd.DataFrame:
    """One row per connection and pair (the content of ``drift.csv``).

    ``peak`` is the largest absolute drift, m, at ``time_of_peak``, s. Its 90 % interval is that of the drift at this
    time: two peaks of nearly the same height are not told apart. Cells of what is not known are empty (NaN).
    """
    found, (_, sample), (_, when) = drift_peaks(drifts), drifts.peaks(), drifts.peaks("true")
    lower, upper = found.interval
    return pd.DataFrame(
        {
            "connection": found.names,
            "peak": found.estimate,
            "std": found.std,
            "lower_90": np.maximum(lower, 0.0),
            "upper_90": upper,
            "time_of_peak": drifts.time[sample],
            "true_peak": found.true,
            "true_time_of_peak": np.where(np.isfinite(found.true), drifts.time[when], np.nan),
            "error_percent": error_percent(found.estimate, found.true),
        }
    )


def drift_peaks(drifts: Histories) -> Estimates:
    """The largest absolute drift of every connection, m."""
    peak, sample = drifts.peaks()
    std = drifts.of("std")[sample, np.arange(len(peak))]
    return Estimates(drifts.places, peak, std, drifts.peaks("true")[0])


def connection_forces(structure: Structure, estimate: Estimate, truth: Truth) -> Histories | None:
    """Internal forces of the same connections, N, NaN of mere pairs; None where the training does not tell them."""
    found, response = estimate.connections, truth.response
    if found is None:
        return None
    sources = {"estimate": found.force, "std": found.force_std}
    known = truth.parameters is not None and np.isfinite(response.velocity).all()
    if known and set(truth.parameters or ()) == set(structure.parameters):
        e, de = (structure.elongation(x) for x in response.stretching)
        force = structure.connection_force(e, de, truth.parameters, response.hidden)
        if np.isfinite(own := force[:, structure.added]).any():
            sources["true"] = own
    names = structure.drift_names
    beside = ((0, 0), (0, len(names) - len(structure.added)))
    padded = {name: np.pad(values, beside, constant_values=np.nan) for name, values in sources.items()}
    return Histories(CONNECTION_FORCE, "connection", names, response.time, padded)


def dissipated_energy(results: Results) -> Estimates:
    """Energy that each of `Structure.added` dissipates over the record, J.

    Of a training that says nothing of it, what its motion and its parameters dissipate, without a deviation. The truth
    is that of the structure that a simulated record comes from.
    """
    estimate, true, truth = results.estimate, results.true, results.truth.response
    structure, known = estimated_structure(results.prescribed, estimate.parameters), estimate.connections
    energy = None if known is None else known.dissipated
    energy = dissipated(structure, estimate.response) if energy is None else energy
    std, unknown = None if known is None else known.dissipated_std, np.full(len(energy), np.nan)
    told = true is not None and len(true.added) == len(energy) and np.isfinite(truth.velocity).all()
    true_energy = dissipated(true, truth) if true is not None and told else unknown
    names = structure.drift_names[: len(energy)]
    return Estimates(names, energy, unknown if std is None else std, true_energy)


def dissipated(structure: Structure, response: Response) -> np.ndarray:
    """(C,), J: energy dissipated by `Structure.added` in a motion; NaN where a hidden force of it is not known."""
    e, de = (structure.elongation(x) for x in response.stretching)
    parameters, z = structure.parameters_like(e), response.hidden
    if len(structure.memory) and z is None:
        z = np.full((len(e), len(structure.memory)), np.nan)
    energy = trapezoids(response.time) @ dissipated_power(structure, e, de, parameters, z)
    if z is not None:
        stored = stored_by_memory(structure, z[[0, -1]], parameters)
        energy[structure.memory] += stored[0] - stored[1]
    out: np.ndarray = energy[structure.added]
    return out


def energy_table(energy: Estimates) -> pd.DataFrame:
    """One row per connection (the content of ``energy.csv``): energies in J, and the share of all connections."""
    found, total = energy.estimate, float(np.sum(energy.estimate))
    lower, upper = energy.interval
    return pd.DataFrame(
        {
            "connection": energy.names,
            "dissipated": found,
            "std": energy.std,
            "lower_90": lower,
            "upper_90": upper,
            "share_percent": 100.0 * found / total if total > 0.0 else np.nan,
            "true": energy.true,
            "error_percent": error_percent(found, energy.true),
        }
    )
