"""A sampled posterior whole, as ``posterior.nc``.

The file holds ArviZ's InferenceData, for ``arviz.from_netcdf``. It is written group by group with xarray: ArviZ itself
takes seconds to import.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from pinn_cli.record.response import UNITS
from pinn_cli.report.dataset import netcdf_attributes
from pinn_cli.runs.identity import package_version
from pinn_cli.runs.writing import write_bytes
from pinn_cli.system.parameters import LINEAR_TITLES

if TYPE_CHECKING:
    from pinn_cli.posterior.base import PosteriorSamples
    from pinn_cli.posterior.result import ForcePredictive, PosteriorResult
    from pinn_cli.record.record import Record
    from pinn_cli.system.parameters import Parameter

_DRAWN = ("chain", "draw")


def posterior_groups(
    findings: PosteriorResult, record: Record, parameters: Sequence[Parameter], attributes: Mapping[str, object]
) -> dict[str, xr.Dataset]:
    """The groups of an InferenceData.

    Args:
        findings: The draws and, where there is one, the force's posterior predictive.
        record: What the force is compared with.
        parameters: Those that were drawn, in the order of the draws; one whose unit nobody knows is written without.
        attributes: Of the run: text, numbers and booleans; those that are None are left out.

    Returns:
        ``/``: attributes only. ``posterior``: a variable per parameter over (chain, draw), and ``sigma_force`` over
        (chain, draw, force_dof). ``prior``: the parameters over (chain, draw), one chain. With a posterior predictive:
        ``posterior_predictive`` with ``force`` (chain, draw, time, dof), of the draws and at the times that were
        predicted, in single precision, and ``observed_data`` with ``force`` (time, dof). ``sample_stats``: (chain,
        draw), where something was sampled step by step.
    """
    samples, version = findings.samples, package_version("pinn-cli")
    library = {"inference_library": "pinn-cli", **({"inference_library_version": version} if version else {})}
    described = {"long_name": "degree of freedom, 1 is nearest the fixed end", "units": "1"}
    dofs = samples.force_dofs.astype(np.int32), described
    noise = {"long_name": "standard deviation of the measured force's noise", "units": UNITS["force"]}
    posterior = _parameters(samples.draws, parameters)
    posterior["sigma_force"] = ((*_DRAWN, "force_dof"), samples.sigma_force, noise)
    posterior["force_dof"] = ("force_dof", *dofs)
    # ArviZ's own names for the two.
    sampling = {"tuning_steps": samples.warmup, "sampling_time": float(np.max(samples.seconds, initial=0.0))}
    groups = {
        "/": xr.Dataset(attrs={**netcdf_attributes(attributes), **library, "method": samples.method}),
        "posterior": posterior.assign_attrs(library | sampling),
        "prior": _parameters(samples.prior[None], parameters).assign_attrs(library),
    }
    if findings.predictive is not None:
        for name, group in _forces(findings.predictive, samples, record, dofs).items():
            groups[name] = group.assign_attrs(library)
    if samples.statistics:
        statistics = {name: (_DRAWN, values) for name, values in samples.statistics.items()}
        groups["sample_stats"] = xr.Dataset(statistics, _counted(*samples.draws.shape[:2]))
    return groups


def write_posterior_data(groups: Mapping[str, xr.Dataset], path: Path | str) -> Path:
    """Write the groups as netCDF 4 through h5netcdf."""
    return write_bytes(xr.DataTree.from_dict(dict(groups)).to_netcdf(None, engine="h5netcdf", format="NETCDF4"), path)


def _parameters(draws: np.ndarray, parameters: Sequence[Parameter]) -> xr.Dataset:
    """(chains, draws, p) as a variable per parameter."""
    variables = {p.name: (_DRAWN, draws[..., i], _description(p)) for i, p in enumerate(parameters)}
    return xr.Dataset(variables, _counted(*draws.shape[:2]))


def _description(parameter: Parameter) -> dict[str, str]:
    linear = parameter.kind in LINEAR_TITLES
    title = parameter.title.lower() if linear else f"{parameter.title or parameter.kind} coefficient"
    described = {"long_name": f"{title} of {parameter.owner}"}
    return described | ({"units": parameter.unit} if parameter.unit else {})


def _counted(chains: int, draws: int) -> dict[str, Any]:
    return {"chain": np.arange(chains), "draw": np.arange(draws)}


def _forces(
    predictive: ForcePredictive, samples: PosteriorSamples, record: Record, dofs: tuple[np.ndarray, dict[str, str]]
) -> dict[str, xr.Dataset]:
    """The predicted force, and what was observed of it."""
    time = ("time", record.time[predictive.samples], {"long_name": "time", "units": "s"})
    places = {"time": time, "dof": ("dof", *dofs)}
    drawn = {"chain": np.arange(len(predictive.force)), "draw": predictive.draws}
    # Ten times as many numbers as everything else together: seven digits of a noisy force are plenty.
    force = predictive.force.astype(np.float32)
    words = {"long_name": "force, posterior predictive", "units": UNITS["force"]}
    measured = record.force[np.ix_(predictive.samples, samples.force_dofs - 1)]
    observed = (("time", "dof"), measured, {"long_name": "observed force", "units": UNITS["force"]})
    predicted = ((*_DRAWN, "time", "dof"), force, words)
    return {
        "posterior_predictive": xr.Dataset({"force": predicted}, drawn | places),
        "observed_data": xr.Dataset({"force": observed}, places),
    }
