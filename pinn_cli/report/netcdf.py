"""``response.nc``, the labelled time histories of a run, and ``posterior.nc``, its sampled posterior.

The second has the groups of ArviZ, for ``arviz.from_netcdf``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from pinn_cli.posterior.posterior import PosteriorResult, PosteriorSamples
from pinn_cli.record.record import Record
from pinn_cli.record.response import RESPONSE_QUANTITIES, Response
from pinn_cli.report import estimates
from pinn_cli.report.results import Results
from pinn_cli.runs.histories import HISTORIES
from pinn_cli.runs.identity import package_version
from pinn_cli.runs.reading import stamp
from pinn_cli.runs.writing import write_bytes
from pinn_cli.system.parameters import LINEAR_TITLES, Parameter
from pinn_cli.system.quantities import GROUND, SUPPORT, UNITS

# The suffix of a variable and its description, by its source.
SOURCES = {
    "estimate": ("", "estimated {}"),
    "std": ("_std", "standard deviation of the estimated {}"),
    "true": ("_true", "true {}"),
    "observed": ("_observed", "observed {}"),
    "free_run": ("_free_run", "{} of the estimated system under the measured force"),
}
_DRAWN = ("chain", "draw")


def response_dataset(results: Results, free_run: Response | None = None) -> xr.Dataset:
    """Everything that a figure of the response needs, labelled, and the motion of the estimated system by itself.

    Returns:
        For each quantity ``displacement`` (estimate), ``displacement_std``, ``displacement_true`` (left out where no
        DOF's truth is known), ``displacement_observed`` (NaN where there is no sensor, and where it has no sample) and
        ``displacement_free_run`` (left out where there is none), and so on for velocity, acceleration and force (which
        has no free run), over ``time`` (s) and ``dof`` (from 1, of a chain nearest the fixed end; ``dof_name`` where
        DOFs have names); then ``displacement_<name>`` of the baseline and ``displacement_<name>_std``. Where the ground
        moves, ``ground_acceleration`` and the same of it over ``time``, each left out where there is none. ``drift``,
        ``drift_std`` and, where known, ``drift_true`` over ``time`` and ``connection`` (its name, or its number from
        1); the same of ``connection_force``, NaN of pairs of DOFs. Where supports move, ``support_displacement`` and
        its derivatives, and the same of these, over ``time`` and ``support``. ``observed`` and ``unforced``: DOFs with
        a response sensor, and those known to carry no force. Attributes are the run's labels.
    """
    run, record, truth, of_dofs = results.run, results.record, results.truth, estimates.dof_histories(results)
    stretched = estimates.drifts(results.prescribed, results.estimate, truth.response)
    forces = estimates.connection_forces(results.prescribed, results.estimate, truth)
    moved = {} if free_run is None else {name: getattr(free_run, name) for name in RESPONSE_QUANTITIES}
    variables: dict[str, tuple[Any, ...]] = {}
    for histories in of_dofs:
        variables |= _variables(histories.with_sources(free_run=moved.get(histories.name)), SOURCES)
    if results.baseline is not None:
        name, other = run.baseline, results.baseline
        described = {
            "estimate": (f"_{name}", f"{{}} estimated by {name}"),
            "std": (f"_{name}_std", f"standard deviation of the {{}} estimated by {name}"),
        }
        for histories in of_dofs:
            sources = {"estimate": getattr(other.response, histories.name), "std": getattr(other.std, histories.name)}
            variables |= _variables(replace(histories, sources=sources), described)
    supports = [estimates.history_of(results, name) for name in SUPPORT]
    for further in (estimates.history_of(results, GROUND), stretched, *supports, forces):
        variables |= {} if further is None else _variables(further, SOURCES)
    fixed = {
        "Conventions": "CF-1.11",
        "title": "Estimated response of a structure",
        "intersample": record.intersample,
        "frame": None if record.ground_acceleration is None else record.frame,
    }
    attributes = netcdf_attributes(fixed | run.labels_of(estimator="pinn"))
    return xr.Dataset(variables, coords=_coordinates(record, stretched.places), attrs=attributes)


def _variables(histories: estimates.Histories, sources: Mapping[str, tuple[str, str]]) -> dict[str, tuple[Any, ...]]:
    """Dimensions, values and attributes of every source, which ``sources`` give a suffix and a description."""
    out = {}
    for source, values in histories.sources.items():
        suffix, description = sources[source]
        dims, shown = (("time", histories.axis), values) if histories.axis else (("time",), values[:, 0])
        out[histories.name + suffix] = (dims, shown, _attributes(description.format(histories.words), histories.unit))
    return out


def _coordinates(record: Record, connections: Sequence[str]) -> dict[str, tuple[str, np.ndarray, dict[str, str]]]:
    dofs = np.arange(1, record.ndof + 1, dtype=np.int32)
    names = {"dof_name": ("dof", np.array(record.dofs, dtype=object), _attributes("name"))} if record.dofs else {}
    supports = {"support": ("support", np.array(record.support_names), _attributes("support that moves"))}
    stretched = _attributes("connection; what it joins is stretched by its drift")
    return {
        **names,
        "time": ("time", record.time, _attributes("time", "s")),
        "dof": ("dof", dofs, _attributes("degree of freedom, of a chain counted from the fixed end", "1")),
        "observed": ("dof", record.observed, _attributes("has a displacement, velocity or acceleration sensor")),
        "unforced": ("dof", record.unforced, _attributes("is known to carry no force")),
        **(supports if record.supports else {}),
        "connection": ("connection", np.array(connections), stretched),
    }


def _attributes(long_name: str, units: str = "") -> dict[str, str]:
    return {"long_name": long_name, **({"units": units} if units else {})}


def write_dataset(dataset: xr.Dataset | xr.DataTree, path: Path | str) -> Path:
    """Write it as netCDF 4 through h5netcdf; in memory first, since HDF5 does not outlive a full disk."""
    dataset.attrs |= stamp(HISTORIES)
    return write_bytes(dataset.to_netcdf(None, engine="h5netcdf", format="NETCDF4"), path)


def netcdf_attributes(given: Mapping[str, object]) -> dict[str, object]:
    """Attributes as netCDF can hold them: no null, no boolean."""
    kept = {name: value for name, value in given.items() if value is not None}
    return {name: int(value) if isinstance(value, bool | np.bool_) else value for name, value in kept.items()}


def posterior_groups(
    findings: PosteriorResult, record: Record, parameters: Sequence[Parameter], attributes: Mapping[str, object]
) -> dict[str, xr.Dataset]:
    """The groups, as ArviZ names them. ``parameters`` are in the order of the draws.

    Returns:
        ``/``: attributes only, those of the run that are not None. ``posterior``: a variable per parameter over (chain,
        draw), and ``sigma_force`` over (chain, draw, force_dof). ``prior``: the parameters over (chain, draw), one
        chain. With a posterior predictive: ``posterior_predictive`` with ``force`` (chain, draw, time, dof), of the
        draws and at the times that were predicted, in single precision, and ``observed_data`` with ``force`` (time,
        dof). ``sample_stats``: (chain, draw), where something was sampled step by step.
    """
    samples, version, predictive = findings.samples, package_version("pinn-cli"), findings.predictive
    library = {"inference_library": "pinn-cli", **({"inference_library_version": version} if version else {})}
    posterior, unit = _parameters(samples.draws, parameters), UNITS["force"]
    noise = _attributes("standard deviation of the measured force's noise", unit)
    posterior["sigma_force"] = ((*_DRAWN, "force_dof"), samples.sigma_force, noise)
    posterior["force_dof"] = ("force_dof", *_dofs(samples))
    # ArviZ's own names for the two.
    sampling = {"tuning_steps": samples.warmup, "sampling_time": float(np.max(samples.seconds, initial=0.0))}
    groups = {"posterior": posterior.assign_attrs(sampling), "prior": _parameters(samples.prior[None], parameters)}
    if predictive is not None:
        time = ("time", record.time[predictive.samples], _attributes("time", "s"))
        places = {"time": time, "dof": ("dof", *_dofs(samples))}
        drawn = {"chain": np.arange(len(predictive.force)), "draw": predictive.draws}
        # Ten times as many numbers as everything else together: seven digits of a noisy force are plenty.
        force = predictive.force.astype(np.float32)
        predicted = ((*_DRAWN, "time", "dof"), force, _attributes("force, posterior predictive", unit))
        measured = record.force[np.ix_(predictive.samples, samples.force_dofs - 1)]
        shown = (("time", "dof"), measured, _attributes("observed force", unit))
        groups["posterior_predictive"] = xr.Dataset({"force": predicted}, drawn | places)
        groups["observed_data"] = xr.Dataset({"force": shown}, places)
    groups = {name: group.assign_attrs(library) for name, group in groups.items()}
    if samples.statistics:
        statistics = {name: (_DRAWN, values) for name, values in samples.statistics.items()}
        groups["sample_stats"] = xr.Dataset(statistics, _counted(*samples.draws.shape[:2]))
    about = {**netcdf_attributes(attributes), **library, "method": samples.method}
    return {"/": xr.Dataset(attrs=about), **groups}


def _parameters(draws: np.ndarray, parameters: Sequence[Parameter]) -> xr.Dataset:
    """(chains, draws, p) as a variable per parameter."""
    variables = {}
    for i, p in enumerate(parameters):
        title = p.title.lower() if p.kind in LINEAR_TITLES else f"{p.title or p.kind} coefficient"
        variables[p.name] = (_DRAWN, draws[..., i], _attributes(f"{title} of {p.owner}", p.unit))
    return xr.Dataset(variables, _counted(*draws.shape[:2]))


def _counted(chains: int, draws: int) -> dict[str, Any]:
    return {"chain": np.arange(chains), "draw": np.arange(draws)}


def _dofs(samples: PosteriorSamples) -> tuple[np.ndarray, dict[str, str]]:
    return samples.force_dofs.astype(np.int32), _attributes("degree of freedom, 1 is nearest the fixed end", "1")
