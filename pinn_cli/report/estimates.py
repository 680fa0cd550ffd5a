"""What was estimated, with its deviation and where known its truth: numbers, and histories at every place.

A quantity is a function here that returns one of the two; tables, files and figures take any of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import torch

from pinn_cli.record.record import Record, Truth
from pinn_cli.record.response import QUANTITIES, Response
from pinn_cli.report.results import Results
from pinn_cli.system.connection.nonlinearity import OVER
from pinn_cli.system.energy import dissipated_power, stored_by_memory, trapezoids
from pinn_cli.system.modes import NaturalModes, frequency
from pinn_cli.system.priors import HALF_WIDTH_90
from pinn_cli.system.quantities import CONNECTION_FORCE, GROUND, SUPPORT, UNITS
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import Estimate, estimated_structure, sought_laws
from pinn_cli.training.propagation import half_widths_90

CURVE_PLACES = 101  # of a curve


@dataclass(frozen=True, eq=False)
class Estimates:
    """P numbers of one kind; NaN where something is not known.

    Attributes:
        names: (P,), what each is called.
        estimate, std: (P,), in the unit of the numbers; their intervals are those of normal distributions.
        true: (P,).
    """

    names: tuple[str, ...]
    estimate: np.ndarray
    std: np.ndarray
    true: np.ndarray

    @property
    def interval(self) -> np.ndarray:
        """(2, P), the central 90 % interval."""
        half = HALF_WIDTH_90 * self.std
        return np.stack((self.estimate - half, self.estimate + half))

    def table(self, head: str, value: str, true: str, **further: np.ndarray | float) -> pd.DataFrame:
        """Columns: the names, the estimate, ``std``, ``lower_90``, ``upper_90``, others, the truth, ``error_percent``.

        ``head``, ``value`` and ``true`` are what three of them are called; ``further`` are others.
        """
        lower, upper = self.interval
        columns = {head: self.names, value: self.estimate, "std": self.std, "lower_90": lower, "upper_90": upper}
        scored = {true: self.true, "error_percent": error_percent(self.estimate, self.true)}
        return pd.DataFrame(columns | further | scored)


def error_percent(estimate: np.ndarray, true: np.ndarray) -> np.ndarray:
    """100 |estimate - true| / |true|, as in the paper's tables; NaN where the truth is zero or unknown."""
    with np.errstate(divide="ignore", invalid="ignore"):
        error: np.ndarray = np.where(true != 0.0, 100.0 * np.abs(estimate - true) / np.abs(true), np.nan)
    return error


@dataclass(frozen=True, eq=False)
class Histories:
    """One quantity at C places over N times.

    Attributes:
        name: Of the quantity in ``response.nc``: ``displacement``, ``connection_force``.
        axis: What the places are: ``dof``, ``connection``, ``support``; "" of the ground, which is one.
        places: (C,), their names, or their numbers from 1.
        time: (N,), s.
        sources: Source to values (N, C): the ``estimate``, its deviation ``std``, what is ``true``, what was
            ``observed``, what a ``free_run`` makes of it, and so on; a source that there is not is left out.
    """

    name: str
    axis: str
    places: tuple[str, ...]
    time: np.ndarray
    sources: Mapping[str, np.ndarray]

    @property
    def unit(self) -> str:
        """Of the values, SI."""
        return {**UNITS, "drift": UNITS["displacement"]}[self.name]

    @property
    def words(self) -> str:
        """What people call the quantity."""
        special = {GROUND: "ground acceleration", CONNECTION_FORCE: "internal force"}
        return special.get(self.name) or (f"{SUPPORT[self.name]} of the support" if self.name in SUPPORT else self.name)

    def of(self, source: str) -> np.ndarray:
        """(N, C), NaN where there is none."""
        values = self.sources.get(source)
        return np.full((len(self.time), len(self.places)), np.nan) if values is None else values

    def with_sources(self, **sources: np.ndarray | None) -> Histories:
        """The same with further sources, those that are not None."""
        return replace(self, sources={**self.sources, **{name: x for name, x in sources.items() if x is not None}})

    def peaks(self, source: str = "estimate") -> tuple[np.ndarray, np.ndarray]:
        """Largest absolute value at every place and its sample, each (C,)."""
        values = self.of(source)
        sample = np.argmax(np.abs(values), axis=0)
        return np.abs(values[sample, np.arange(values.shape[1])]), sample

    def peak_estimates(self) -> Estimates:
        """The largest absolute value at every place; its deviation is that of the history at this time."""
        peak, sample = self.peaks()
        std = self.of("std")[sample, np.arange(len(peak))]
        return Estimates(self.places, peak, std, self.peaks("true")[0])


def history_of(results: Results, name: str) -> Histories | None:
    """A quantity of DOFs, of the ground or of supports: estimated, true where known at any place, and observed.

    None where nobody knows anything of it.
    """
    record, truth = results.record, results.truth.response
    axis, places, true = "dof", tuple(record.dof_name(i) for i in range(record.ndof)), values_of(truth, name)
    is_measured, is_known = True, true is not None and bool(np.isfinite(true).any())
    if name == GROUND:
        axis, places, is_measured = "", ("ground",), record.measured_ground is not None
    elif name in SUPPORT:
        axis, places, is_measured, is_known = "support", tuple(record.support_names), name in record.supports, False
    sources = {
        "estimate": values_of(results.estimate.response, name),
        "std": values_of(results.estimate.std, name),
        "true": true if is_known else None,
        "observed": observed(record, name) if is_measured else None,
    }
    known = {source: values for source, values in sources.items() if values is not None}
    return Histories(name, axis, places, record.time, known) if known else None


def dof_histories(results: Results) -> list[Histories]:
    """Motion and force of every DOF."""
    return [histories for name in QUANTITIES if (histories := history_of(results, name))]


def values_of(response: Response, name: str) -> np.ndarray | None:
    """(N, C) of a quantity of DOFs, of the ground or of supports; None where a response has none."""
    if name in SUPPORT:
        return None if response.supports is None else response.supports[:, list(SUPPORT).index(name)]
    values: np.ndarray | None = getattr(response, name)
    return values[:, None] if values is not None and values.ndim == 1 else values


def observed(record: Record, quantity: str) -> np.ndarray:
    """(N, C), what sensors measured; NaN where there is none, and where one has no sample."""
    # A force that is known to be zero is 0 in the record; nobody has measured it.
    shown = np.where(record.sensors(quantity), record.histories(quantity), np.nan)
    for channel in record.corrected:
        if channel.place[0] == quantity:
            shown[~channel.there, channel.place[1]] = np.nan
    return shown


def drifts(structure: Structure, estimate: Estimate, truth: Response) -> Histories:
    """Elongations of connections and, behind them, of pairs of DOFs: of a storey, its drift.

    ``truth`` is NaN where unknown: the drift of a connection is known where all that it joins are.
    """
    stretch, connections = structure.drifts_of_dofs, estimate.connections
    elongation = _with_supports(estimate.response, structure.supports) @ stretch.T
    std = np.full(elongation.shape, np.nan) if connections is None else connections.elongation_std
    displacement = _with_supports(truth, structure.supports)
    joins = abs(stretch) @ np.isnan(displacement).any(axis=0).astype(float) > 0.0
    true = np.where(joins, np.nan, np.nan_to_num(displacement) @ stretch.T)
    names, sources = structure.drift_names, {"estimate": elongation, "std": std}
    histories = Histories("drift", "connection", names, estimate.response.time, sources)
    return histories.with_sources(true=true if np.isfinite(true).any() else None)


def _with_supports(response: Response, supports: int) -> np.ndarray:
    """(N, n + S), displacements of DOFs and of supports, NaN where these are not known."""
    unknown = np.full((len(response.time), supports), np.nan)
    return np.hstack((response.displacement, unknown if response.supports is None else response.supports[:, 0]))


def drift_table(drifts: Histories) -> pd.DataFrame:
    """One row per connection and pair (the content of ``drift.csv``).

    ``peak`` is the largest absolute drift, m, at ``time_of_peak``, s. Its 90 % interval is that of the drift at this
    time: two peaks of nearly the same height are not told apart. Cells of what is not known are empty (NaN).
    """
    peaks, (_, sample), (_, when) = drifts.peak_estimates(), drifts.peaks(), drifts.peaks("true")
    table = peaks.table("connection", "peak", "true_peak", time_of_peak=drifts.time[sample])
    table["lower_90"] = table["lower_90"].clip(lower=0.0)
    true_time = np.where(np.isfinite(peaks.true), drifts.time[when], np.nan)
    table.insert(len(table.columns) - 1, "true_time_of_peak", true_time)
    return table


def connection_forces(structure: Structure, estimate: Estimate, truth: Truth) -> Histories | None:
    """Internal forces of the same connections, N, NaN of mere pairs; None where the training does not tell them."""
    connections, response = estimate.connections, truth.response
    if connections is None:
        return None
    sources = {"estimate": connections.force, "std": connections.force_std}
    is_known = truth.parameters is not None and np.isfinite(response.velocity).all()
    if is_known and set(truth.parameters or ()) == set(structure.parameters):
        e, de = (structure.elongation(x) for x in response.stretching)
        force = structure.connection_force(e, de, truth.parameters, response.hidden)
        if np.isfinite(true := force[:, structure.added]).any():
            sources["true"] = true
    names = structure.drift_names
    padding = ((0, 0), (0, len(names) - len(structure.added)))
    padded = {name: np.pad(values, padding, constant_values=np.nan) for name, values in sources.items()}
    return Histories(CONNECTION_FORCE, "connection", names, response.time, padded)


def dissipated_energy(results: Results) -> Estimates:
    """Energy that each of `Structure.added` dissipates over the record, J.

    Of a training that says nothing of it, what its motion and its parameters dissipate, without a deviation. The truth
    is that of the structure that a simulated record comes from.
    """
    estimate, true, truth = results.estimate, results.true, results.truth.response
    structure, connections = estimated_structure(results.prescribed, estimate.parameters), estimate.connections
    energy = None if connections is None else connections.dissipated
    energy = dissipated(structure, estimate.response) if energy is None else energy
    std, unknown = None if connections is None else connections.dissipated_std, np.full(len(energy), np.nan)
    is_known = true is not None and len(true.added) == len(energy) and np.isfinite(truth.velocity).all()
    true_energy = dissipated(true, truth) if true is not None and is_known else unknown
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
        np.add.at(energy, structure.memory, stored[0] - stored[1])
    return energy[structure.added]


def energy_table(energy: Estimates) -> pd.DataFrame:
    """One row per connection (the content of ``energy.csv``): energies in J, and the share of all connections."""
    total = float(np.sum(energy.estimate))
    share = 100.0 * energy.estimate / total if total > 0.0 else np.nan
    return energy.table("connection", "dissipated", "true", share_percent=share)


@dataclass(frozen=True, eq=False)
class ModeEstimates:
    """Modes of the estimated structure, linearised about rest, beside those of two others.

    Attributes:
        dofs: Names of the DOFs; their numbers from 1 where they have none.
        is_chain: Whether each DOF follows the one before.
        table: One row per mode, the lowest frequency first (the content of ``modes.csv``). Frequencies are in Hz and
            undamped; ``lower_90`` and ``upper_90`` are of the frequency. ``mac`` is the modal assurance criterion
            against the prescribed mode that is most alike, whose frequency and damping follow; ``true_mac`` the same of
            the structure that a simulated record comes from. A column ``shape_<dof>`` per DOF is its displacement where
            the mode's largest is one. Cells of what is not known are empty (NaN).
        shapes: (dofs, modes) of the ``estimate``, the ``prescribed`` and the ``true`` structure, all with one sign.
    """

    dofs: tuple[str, ...]
    is_chain: bool
    table: pd.DataFrame
    shapes: Mapping[str, np.ndarray]

    @classmethod
    def of(cls, prescribed: Structure, estimate: Estimate, true: Structure | None = None) -> ModeEstimates | None:
        """Of an estimate; None where its parameters make no structure, a mass being zero.

        The intervals are those that the parameters' own ones and their correlation make to first order, of omega^2 and
        of the damping ratio: what is held fixed counts as exact.
        """
        structure = estimated_structure(prescribed, estimate.parameters)
        modes = NaturalModes.of(structure)
        if modes is None:
            return None
        intervals = []
        slopes = modes.slopes([p.parameter for p in estimate.parameters])
        for values, slope in zip((modes.squares, modes.damping_ratios), slopes, strict=True):
            below, above = half_widths_90(slope, estimate.parameters, estimate.correlation)
            intervals.append(np.stack((values - below, values + above)))
        squares, ratios = intervals
        lower, upper = frequency(np.where(squares < 0, 0.0, squares))
        mac, given_frequencies, given_ratios, given_shapes = _most_alike(prescribed, modes)
        true_mac, true_frequencies, true_ratios, true_shapes = _most_alike(true, modes)
        columns: dict[str, np.ndarray] = {
            "mode": np.arange(1, len(modes.squares) + 1),
            "frequency": modes.frequencies,
            "lower_90": lower,
            "upper_90": upper,
            "damping_ratio": modes.damping_ratios,
            "damping_ratio_lower_90": ratios[0],
            "damping_ratio_upper_90": ratios[1],
            "mac": mac,
            "prescribed_frequency": given_frequencies,
            "prescribed_damping_ratio": given_ratios,
            "true_frequency": true_frequencies,
            "true_damping_ratio": true_ratios,
            "frequency_error_percent": error_percent(modes.frequencies, true_frequencies),
            "damping_ratio_error_percent": error_percent(modes.damping_ratios, true_ratios),
            "true_mac": true_mac,
        }
        dofs = tuple(structure.dof_name(i) for i in range(structure.ndof))
        columns |= {f"shape_{dof}": row for dof, row in zip(dofs, modes.shapes, strict=True)}
        is_chain = not structure.is_modal and not structure.labels.connections
        shapes = {"true": true_shapes, "prescribed": given_shapes, "estimate": modes.shapes}
        return cls(dofs, is_chain, pd.DataFrame(columns), shapes)


def _most_alike(
    structure: Structure | None, modes: NaturalModes
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """MAC, frequencies (Hz) and damping ratios (modes,), and shapes (dofs, modes), of the modes of another structure.

    They are those that are most like the given ones, and have their sign; NaN where it has not as many.
    """
    other = None if structure is None else NaturalModes.of(structure)
    if other is None or other.of_dofs.shape != modes.of_dofs.shape:
        nothing = np.full(len(modes.squares), np.nan)
        return nothing, nothing, nothing, np.full(modes.of_dofs.shape, np.nan)
    to, index = modes.partners(other), np.arange(len(modes.squares))
    sign = np.where(np.sum(modes.shapes * other.shapes[:, to], axis=0) < 0, -1.0, 1.0)
    mac = modes.assurance(other)[index, to]
    return mac, other.frequencies[to], other.damping_ratios[to], sign * other.shapes[:, to]


@dataclass(frozen=True, eq=False)
class RestoringCurve:
    """The force r of a connection whose law was sought, over elongation at rest, or over speed where it is unstretched.

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
        if connection not in sought or structure.laws[connection].states:
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
        std = np.hypot(std, structure.unresolved_force(e.numpy(), de.numpy())[:, connection])
    truth = results.truth.parameters
    if truth is not None and set(truth) == set(structure.parameters):
        true = results.prescribed.connection_force(e.numpy(), de.numpy(), truth)[:, connection]
    return Estimates((), slope.force[:, connection].numpy(), std, true)


def restoring_table(curves: Sequence[RestoringCurve]) -> pd.DataFrame:
    """One row per place of a curve (the content of ``restoring.csv``)."""
    tables = []
    for curve in curves:
        force, (lower, upper) = curve.force, curve.force.interval
        values = {"force": force.estimate, "std": force.std, "lower_90": lower, "upper_90": upper}
        tables.append(pd.DataFrame({"connection": curve.connection, "over": curve.over, "at": curve.at} | values))
        tables[-1]["true_force"] = force.true
    return pd.concat(tables, ignore_index=True)
