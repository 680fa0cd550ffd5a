"""The figures of a finished run, drawn when they are asked for as the run itself draws them, from its files."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.figure import Figure
from omegaconf import OmegaConf

from pinn_cli.cli.config import resolved
from pinn_cli.cli.source import SIMULATED, chosen_model, read_structure
from pinn_cli.model.file import NAME as MODEL
from pinn_cli.model.file import stored_model
from pinn_cli.record.channel import Channel
from pinn_cli.record.record import Record, Truth
from pinn_cli.record.response import QUANTITIES, RESPONSE_QUANTITIES, Response
from pinn_cli.report.figures import record_figures, run_figures
from pinn_cli.report.figures.posterior import posterior_pairs_figure
from pinn_cli.report.figures.style import for_notebooks
from pinn_cli.report.results import LABELS, Results, RunDescription, checked_times, in_functions_of
from pinn_cli.runs.histories import read_histories
from pinn_cli.runs.reading import read_table, undamaged
from pinn_cli.runs.resume import read_record
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.instantiation import build, check_classes
from pinn_cli.settings.yaml_file import read_yaml
from pinn_cli.system.basis import with_functions_of
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.quantities import CALIBRATION_UNITS, GROUND
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import ConnectionHistories, Estimate, ParameterEstimate
from pinn_cli.training.noise_model import FoundNoise

# Those that figures are drawn from; others may lie in the directory, a user's own among them.
DRAWN_TABLES = ("history", "parameters", "identifiability", "correlation")
FIGURES = (
    "response", "residuals", "error_map", "frequency_response", "drift", "discrepancy", "restoring", "hysteresis",
    "parameters", "correlation", "modes", "structure", "history", "posterior",
)  # fmt: skip
OF_TIME = ("response", "drift")  # those that can be asked for a part of the record


class Plots:
    """``result.plot``: each method returns a matplotlib figure, which a notebook shows.

    - ``response()``: estimated response with 95 % bands, measurements, and the truth where it is known, DOF by DOF
    - ``residuals()``: what the estimate leaves of every sensor, over time, frequency and lag
    - ``error_map()``: error, or standard deviation where there is no truth, over time and DOF
    - ``frequency_response()``: of a record of modes in a band
    - ``drift()``: how far every connection is stretched; ``hysteresis()``: loops of those that have memory
    - ``restoring()``: forces of connections whose law was sought; ``discrepancy()``: what the model leaves out
    - ``parameters()``: with 90 % intervals; ``correlation()``: which of them the record cannot tell apart
    - ``modes()``: shapes with frequencies and damping ratios
    - ``structure()``: masses and connections of a structure that is no chain
    - ``history()``: loss terms and weights over the iterations
    - ``posterior()``: distributions of the parameters, with ``scheme=bayesian``

    ``response(between=(1.9, 2.5))`` and ``drift`` likewise show those seconds of the record, such as a hammer's blow.

    Args:
        directory: Of the run whose figures they are; of several records solved together those of the first.

    Raises:
        InputError: The run has nothing for that figure.
    """

    def __init__(self, directory: Path) -> None:
        self._directory = directory

    @cached_property
    def _results(self) -> Results:
        with undamaged("directory", self._directory):
            return stored_results(self._directory)

    @cached_property
    def _builders(self) -> dict[str, Callable[[], Figure]]:
        return self._builders_of(self._results)

    def _builders_of(self, results: Results) -> dict[str, Callable[[], Figure]]:
        """How each is built."""
        place = self._directory
        with undamaged("directory", place):
            drawn = record_figures(results) | run_figures(results)
            builders: dict[str, Callable[[], Figure]] = {name: build for name, (_, build) in drawn.items()}
            if (place / "posterior.nc").is_file():
                draws = read_histories(place / "posterior.nc", "posterior")
                parameters = [estimate.parameter for estimate in results.estimate.parameters]
                builders["posterior"] = partial(posterior_pairs_figure, draws, parameters, results.truth.parameters)
        return builders

    @property
    def names(self) -> list[str]:
        """Those that the run has something for."""
        return list(self._builders)

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *FIGURES]

    def __getattr__(self, name: str) -> Callable[..., Figure]:
        if name not in FIGURES:
            raise AttributeError(f"a run has no figure {name!r}")
        return partial(self._drawn, name)

    def _drawn(self, name: str, between: tuple[float, float] | None = None) -> Figure:
        if name not in self._builders:
            raise InputError(f"plot.{name}", "()", f"one of {', '.join(self.names)}", "the run has nothing for it")
        builders = self._builders
        if between is not None:
            if name not in OF_TIME:
                raise InputError(f"plot.{name}, between", between, "left out", f"{' and '.join(OF_TIME)} take it")
            shown = checked_times(f"plot.{name}, between", between, self._results.record.time)
            builders = self._builders_of(replace(self._results, shown=shown))
        return for_notebooks(builders[name]())


def stored_results(directory: Path) -> Results:
    """What a run found, of several records the first: all that its figures need, but for a linear model's response.

    Raises:
        InputError: Its settings cannot be read, or name files that are no longer there.
    """
    true, prescribed, simulated = _structures(directory)
    data, run = read_histories(directory / "response.nc"), read_record(directory)
    tables = {name: read_table(file) for name in DRAWN_TABLES if (file := directory / f"{name}.csv").is_file()}
    history, parameters = tables["history"], _parameters(tables, prescribed)
    correlation = None
    if "correlation" in tables:
        correlation = tables["correlation"].set_index("parameter").to_numpy(dtype=np.float64)
    trained = dict[str, Any](run["training"])
    estimate = Estimate(
        _response(data, ""), _response(data, "_std"), parameters, history, trained, correlation,
        connections=_connections(data), noise=FoundNoise.read(trained),
    )  # fmt: skip
    truth = Truth(_response(data, "_true"), true.parameters_like(np.empty(0)) if simulated else None)
    if (directory / MODEL).is_file():
        solved = stored_model(directory, without=("end_", "misfit_", "draws")).structure
        prescribed, truth = with_functions_of(prescribed, solved), in_functions_of(truth, true, solved)
    name = str(run.get("baseline", {}).get("name", "none"))
    baseline = None
    if name != "none":
        baseline = Estimate(_response(data, f"_{name}"), _response(data, f"_{name}_std"), [], history, {})
    labels = {label: data.attrs.get(label) for label in LABELS if label != "estimator"}
    described = RunDescription(
        str(run["case"]), int(run["seed"]), int(run["threads"]), str(run["configuration"]), labels,
        simulated, "none", name,
    )  # fmt: skip
    between = OmegaConf.select(read_yaml(directory / ".hydra" / "config.yaml"), "report.between")
    return Results(
        described, prescribed, _record(data), truth, estimate, baseline, true=true if simulated else None,
        shown=None if between is None else checked_times("report.between", between, data["time"].values),
    )  # fmt: skip


def _structures(directory: Path) -> tuple[Structure, Structure, bool]:
    """The true one, the prescribed one, and whether the record was simulated."""
    config = resolved(read_yaml(directory / ".hydra" / "config.yaml"))
    check_classes(config)
    base = OmegaConf.select(read_yaml(directory / ".hydra" / "hydra.yaml"), "hydra.runtime.cwd")
    place = None if base is None else Path(str(base))
    model_error = build(config.model_error, "model_error")
    model = chosen_model(config, model_error, place)
    structure = read_structure(config, place, model)
    true, prescribed = model_error.structures(structure)
    return true, prescribed if model is None else model.structure, config.data.get("_target_") == SIMULATED


def _parameters(tables: Mapping[str, pd.DataFrame], prescribed: Structure) -> list[ParameterEstimate]:
    by_name = {parameter.name: parameter for parameter in prescribed.every_parameter()}
    prior_std = {}
    if "identifiability" in tables:
        prior_std = dict(tables["identifiability"].set_index("parameter")["prior_std"])
    out = []
    for _, row in tables["parameters"].query("estimator == 'pinn'").iterrows():
        name, unknown = str(row["parameter"]), math.isfinite(row["start"])
        kind = next((kind for kind in CALIBRATION_UNITS if name.startswith(f"{kind}_")), "")
        parameter = by_name.get(name) or Parameter(kind, 0, label=name.removeprefix(f"{kind}_"))
        given, std = float(row["start"] if unknown else row["prescribed"]), float(prior_std.get(name, math.nan))
        believed = replace(parameter, prescribed=given, prior_std=std, unknown=unknown)
        out.append(ParameterEstimate(believed, row["estimate"], row["std"], row["lower_90"], row["upper_90"]))
    return out


def _response(data: xr.Dataset, suffix: str) -> Response:
    """One kind of histories; NaN of what the file has not."""
    unknown = np.full((data.sizes["time"], data.sizes["dof"]), np.nan)
    u, v, a, f = (data[f"{q}{suffix}"].values if f"{q}{suffix}" in data else unknown.copy() for q in QUANTITIES)
    ground = data[f"{GROUND}{suffix}"].values if f"{GROUND}{suffix}" in data else None
    return Response(data["time"].values, u, v, a, f, ground)


def _record(data: xr.Dataset) -> Record:
    """Its sensors; what they missed is filled by straight lines, as in figures of the run."""
    seen, unforced = _response(data, "_observed"), data["unforced"].values.astype(bool)
    channels = []
    for quantity in QUANTITIES:
        values = getattr(seen, quantity)
        gaps = np.isnan(values)
        for dof in np.flatnonzero(gaps.any(axis=0) & ~gaps.all(axis=0)).tolist():
            there = ~gaps[:, dof]
            values[:, dof] = np.interp(seen.time, seen.time[there], values[there, dof])
            channels.append(Channel("", quantity, {dof: 1.0}, seen.time, values[:, dof], gaps=gaps[:, dof]))
    seen.force[:, unforced] = 0.0
    names = tuple(map(str, data["dof_name"].values)) if "dof_name" in data.coords else ()
    return Record(
        **seen.measurable, unforced=unforced, intersample=data.attrs["intersample"],
        frame=data.attrs.get("frame", "absolute"), dofs=names, corrected=tuple(channels),
        responds=any(np.isfinite(getattr(seen, quantity)).any() for quantity in RESPONSE_QUANTITIES),
    )  # fmt: skip


def _connections(data: xr.Dataset) -> ConnectionHistories | None:
    if "connection_force" not in data:
        return None
    return ConnectionHistories(
        *(data[name].values for name in ("drift", "drift_std", "connection_force", "connection_force_std"))
    )
