"""A run read back from its files, as the figures take it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import xarray as xr

from pinn_cli.posterior.samples import PosteriorSamples
from pinn_cli.record.record import QUANTITIES, Record, Response
from pinn_cli.training.estimate import Estimate
from pinn_cli.training.estimated_chain import split_name

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True, eq=False)
class SavedResponse:
    """The content of ``response.nc``.

    Attributes:
        estimate: Response and standard deviations only.
        record: What the estimator saw.
        truth: NaN where unknown; None where nothing is known.
        baselines: Name to response of the other estimators.
    """

    estimate: Estimate
    record: Record
    truth: Response | None
    baselines: dict[str, Response]


def read_response(path: Path, baselines: tuple[str, ...] = ("kalman_smoother",)) -> SavedResponse:
    """Read ``response.nc`` back.

    Args:
        path: Of the file.
        baselines: Names of the estimators to look for beside the network; those that are not there are left out.

    Raises:
        OSError: No such file, or no netCDF file.
        KeyError: A variable is missing.
    """
    with xr.open_dataset(path, engine="h5netcdf") as dataset:
        dataset.load()
    estimate, std = (_response(dataset, suffix) for suffix in ("", "_std"))
    truth = _response(dataset, "_true") if any(f"{name}_true" in dataset for name in QUANTITIES) else None
    found = {name: _response(dataset, f"_{name}") for name in baselines if f"displacement_{name}" in dataset}
    return SavedResponse(Estimate(estimate, std, [], pd.DataFrame(), {}), _record(dataset), truth, found)


def _response(dataset: xr.Dataset, suffix: str) -> Response:
    unknown = np.full((dataset.sizes["time"], dataset.sizes["dof"]), np.nan)
    arrays = (dataset[name + suffix].to_numpy() if name + suffix in dataset else unknown for name in QUANTITIES)
    return Response(dataset["time"].to_numpy(), *arrays)


def _record(dataset: xr.Dataset) -> Record:
    seen = _response(dataset, "_observed")
    unforced = dataset["unforced"].to_numpy().astype(bool)
    force = np.where(unforced, 0.0, seen.force)
    motion = (seen.displacement, seen.velocity, seen.acceleration)
    return Record(seen.time, *motion, force, unforced, intersample=dataset.attrs.get("intersample", "band_limited"))


def read_posterior(path: Path) -> tuple[PosteriorSamples, dict[str, str]]:
    """The draws of ``posterior.nc``, and the unit of each kind of parameter.

    Statistics of the sampler, prior and predictive are left out: the grid of pairs needs none.

    Raises:
        OSError: No such file, or no netCDF file.
    """
    with xr.open_dataset(path, engine="h5netcdf", group="posterior") as dataset:
        dataset.load()
    names = tuple(str(name) for name in dataset.data_vars if dataset[name].dims == ("chain", "draw"))
    draws = np.stack([dataset[name].to_numpy() for name in names], axis=-1)
    units = {split_name(name)[0]: str(dataset[name].attrs.get("units", "")) for name in names}
    dofs, sigma = dataset["force_dof"].to_numpy(), dataset["sigma_force"].to_numpy()
    nothing, chains = np.empty((0, len(names))), len(draws)
    samples = PosteriorSamples("marginal", names, draws, sigma, dofs, nothing, {}, 0, np.zeros(chains))
    return samples, {symbol: unit for symbol, unit in units.items() if unit}


def read_true_parameters(path: Path) -> dict[str, np.ndarray] | None:
    """Symbol to true values (dof,), from ``parameters.csv``; NaN where unknown, None where nothing is known."""
    table = pd.read_csv(path)
    table = table[table["estimator"] == "pinn"] if "estimator" in table else table
    values = {str(row["parameter"]): float(row["true"]) for row in table.to_dict(orient="records")}
    if not np.isfinite(list(values.values())).any():
        return None
    ndof = max(split_name(name)[1] for name in values)
    true: dict[str, np.ndarray] = {}
    for name, value in values.items():
        symbol, connection = split_name(name)
        true.setdefault(symbol, np.full(ndof, np.nan))[connection - 1] = value
    return true
