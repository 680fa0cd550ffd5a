"""What a finished run has found, put together again from its files, for its figures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from omegaconf import OmegaConf

from pinn_cli.cli.config import resolved
from pinn_cli.cli.reuse import chosen_model, structure_beside
from pinn_cli.cli.source import SIMULATED, read_structure
from pinn_cli.record.record import Record, Truth
from pinn_cli.record.response import GROUND, QUANTITIES, RESPONSE_QUANTITIES, Response
from pinn_cli.report.results import LABELS, Results, RunDescription
from pinn_cli.settings.instantiation import build, check_classes
from pinn_cli.settings.yaml_file import read_yaml
from pinn_cli.system.parameters import Parameter
from pinn_cli.system.quantities import CALIBRATION_UNITS
from pinn_cli.training.estimate import ConnectionHistories, Estimate, ParameterEstimate

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from pinn_cli.api.run_files import RunFiles
    from pinn_cli.system.structure import Structure


def stored_results(result: RunFiles) -> Results:
    """What a run found, of several records the first: all that its figures need, but for a linear model's response.

    Raises:
        InputError: Its settings cannot be read, or name files that are no longer there.
    """
    true, prescribed, simulated = _structures(result.directory)
    data, history, run = result.response, result.history, result.run_record
    parameters = _parameters(result, prescribed)
    correlation = None
    if "correlation" in result.tables:
        correlation = result.table("correlation").set_index("parameter").to_numpy(dtype=np.float64)
    estimate = Estimate(
        _response(data, ""), _response(data, "_std"), parameters, history, _numbers(run["training"]), correlation,
        connections=_connections(data),
    )  # fmt: skip
    truth = Truth(_response(data, "_true"), true.parameters_like(np.empty(0)) if simulated else None)
    name = str(run.get("baseline", {}).get("name", "none"))
    baseline = None
    if name != "none":
        baseline = Estimate(_response(data, f"_{name}"), _response(data, f"_{name}_std"), [], history, {})
    labels = {label: data.attrs.get(label) for label in LABELS if label != "estimator"}
    described = RunDescription(
        str(run["case"]), int(run["seed"]), str(run["device"]), int(run["threads"]), str(run["configuration"]), labels,
        simulated, "none", name,
    )  # fmt: skip
    return Results(
        described, prescribed, _record(data), truth, estimate, baseline, true=true if simulated else None
    )  # fmt: skip


def _structures(directory: Path) -> tuple[Structure, Structure, bool]:
    """The true one, the prescribed one, and whether the record was simulated."""
    config = resolved(read_yaml(directory / ".hydra" / "config.yaml"))
    check_classes(config)
    base = OmegaConf.select(read_yaml(directory / ".hydra" / "hydra.yaml"), "hydra.runtime.cwd")
    place = None if base is None else Path(str(base))
    model = chosen_model(config, place)
    structure = read_structure(config, place) if model is None else structure_beside(model, config, place)
    true, prescribed = build(config.model_error, "model_error").structures(structure)
    return true, prescribed if model is None else model.structure, config.data.get("_target_") == SIMULATED


def _parameters(result: RunFiles, prescribed: Structure) -> list[ParameterEstimate]:
    known = {parameter.name: parameter for parameter in prescribed.every_parameter()}
    prior_std = {}
    if "identifiability" in result.tables:
        prior_std = dict(result.table("identifiability").set_index("parameter")["prior_std"])
    rows = result.parameters[result.parameters["estimator"] == "pinn"]
    return [_parameter(row, known, float(prior_std.get(row["parameter"], math.nan))) for _, row in rows.iterrows()]


def _parameter(row: pd.Series[Any], known: Mapping[str, Parameter], prior_std: float) -> ParameterEstimate:
    name, unknown = str(row["parameter"]), math.isfinite(row["start"])
    kind = next((kind for kind in CALIBRATION_UNITS if name.startswith(f"{kind}_")), "")
    found = known.get(name) or Parameter(kind, 0, label=name.removeprefix(f"{kind}_"))
    given = float(row["start"] if unknown else row["prescribed"])
    believed = replace(found, prescribed=given, prior_std=prior_std, unknown=unknown)
    return ParameterEstimate(believed, row["estimate"], row["std"], row["lower_90"], row["upper_90"])


def _response(data: xr.Dataset, suffix: str) -> Response:
    """One kind of histories; NaN of what the file has not."""
    unknown = np.full((data.sizes["time"], data.sizes["dof"]), np.nan)
    u, v, a, f = (data[f"{q}{suffix}"].values if f"{q}{suffix}" in data else unknown.copy() for q in QUANTITIES)
    ground = data[f"{GROUND}{suffix}"].values if f"{GROUND}{suffix}" in data else None
    return Response(data["time"].values, u, v, a, f, ground)


def _record(data: xr.Dataset) -> Record:
    """Its sensors; what they missed is filled by straight lines, as in figures of the run."""
    seen, unforced = _response(data, "_observed"), data["unforced"].values.astype(bool)
    missing = {}
    for quantity in QUANTITIES:
        values = getattr(seen, quantity)
        gaps = np.isnan(values)
        partly = gaps.any(axis=0) & ~gaps.all(axis=0)
        for dof in np.flatnonzero(partly):
            there = ~gaps[:, dof]
            values[:, dof] = np.interp(seen.time, seen.time[there], values[there, dof])
        if partly.any():
            missing[quantity] = np.where(partly, gaps, False)
    seen.force[:, unforced] = 0.0
    names = tuple(map(str, data["dof_name"].values)) if "dof_name" in data.coords else ()
    return Record(
        **seen.measurable, unforced=unforced, intersample=data.attrs["intersample"],
        frame=data.attrs.get("frame", "absolute"), dofs=names, missing=missing,
        responds=any(np.isfinite(getattr(seen, quantity)).any() for quantity in RESPONSE_QUANTITIES),
    )  # fmt: skip


def _connections(data: xr.Dataset) -> ConnectionHistories | None:
    if "connection_force" not in data:
        return None
    return ConnectionHistories(
        *(data[name].values for name in ("drift", "drift_std", "connection_force", "connection_force_std"))
    )


def _numbers(summary: Any) -> Any:
    """What ``run.json`` has as null is no number."""
    if isinstance(summary, Mapping):
        return {name: _numbers(value) for name, value in summary.items()}
    if isinstance(summary, list):
        return [_numbers(value) for value in summary]
    return math.nan if summary is None else summary
