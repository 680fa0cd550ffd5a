"""The labelled time histories of a run, ``response.nc``: estimate, deviation, truth and observations, (time, dof)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.report.connections import connection_forces, drifts
from pinn_cli.report.estimates import Histories, dof_histories, ground_history, support_histories
from pinn_cli.runs.reserved_file import replacing_by_reserved

if TYPE_CHECKING:
    from pinn_cli.record.record import Record
    from pinn_cli.record.response import Response
    from pinn_cli.report.results import Results

# Bytes at most of names, attributes and HDF5's own tables.
AROUND_DATA = 2**20
# The suffix of a variable and its description, by its source.
SOURCES = {
    "estimate": ("", "estimated {}"),
    "std": ("_std", "standard deviation of the estimated {}"),
    "true": ("_true", "true {}"),
    "observed": ("_observed", "observed {}"),
    "free_run": ("_free_run", "{} of the estimated system under the measured force"),
}


def response_dataset(results: Results, free_run: Response | None = None) -> xr.Dataset:
    """Everything that a figure of the response needs, labelled.

    Args:
        results: Of a record.
        free_run: The motion of the estimated system by itself; None where there is none.

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
    run, record, truth = results.run, results.record, results.truth
    of_dofs, ground = dof_histories(results), ground_history(results)
    stretched = drifts(results.prescribed, results.estimate, truth.response)
    forces = connection_forces(results.prescribed, results.estimate, truth)
    variables = {}
    for each in of_dofs:
        moved = None if free_run is None or each.name not in RESPONSE_QUANTITIES else getattr(free_run, each.name)
        variables |= _variables(each.beside(free_run=moved), SOURCES)
    if results.baseline is not None:
        name, other = run.baseline, results.baseline
        described = {
            "estimate": (f"_{name}", f"{{}} estimated by {name}"),
            "std": (f"_{name}_std", f"standard deviation of the {{}} estimated by {name}"),
        }
        for each in of_dofs:
            found = {"estimate": getattr(other.response, each.name), "std": getattr(other.std, each.name)}
            variables |= _variables(replace(each, found=found), described)
    for one in (ground, stretched, *support_histories(results), forces):
        if one is not None:
            variables |= _variables(one, SOURCES)
    fixed = {
        "Conventions": "CF-1.11",
        "title": "Estimated response of a structure",
        "intersample": record.intersample,
        "frame": None if record.ground_acceleration is None else record.frame,
    }
    attributes = netcdf_attributes(fixed | run.labels_of(estimator="pinn"))
    return xr.Dataset(variables, coords=_coordinates(record, stretched.places), attrs=attributes)


def _variables(histories: Histories, sources: Mapping[str, tuple[str, str]]) -> dict[str, tuple[Any, ...]]:
    """Dimensions, values and attributes of every source, which ``sources`` give a suffix and a description."""
    out = {}
    for source, values in histories.found.items():
        suffix, description = sources[source]
        described = {"long_name": description.format(histories.words), "units": histories.unit}
        dims, shown = (("time", histories.axis), values) if histories.axis else (("time",), values[:, 0])
        out[histories.name + suffix] = (dims, shown, described)
    return out


def _coordinates(record: Record, connections: Sequence[str]) -> dict[str, tuple[str, np.ndarray, dict[str, str]]]:
    dofs = np.arange(1, record.ndof + 1, dtype=np.int32)
    names = {"dof_name": ("dof", np.array(record.dofs, dtype=object), {"long_name": "name"})} if record.dofs else {}
    coordinates = names | {
        "time": ("time", record.time, {"long_name": "time", "units": "s"}),
        "dof": ("dof", dofs, {"long_name": "degree of freedom, of a chain counted from the fixed end", "units": "1"}),
        "observed": ("dof", record.observed, {"long_name": "has a displacement, velocity or acceleration sensor"}),
        "unforced": ("dof", record.unforced, {"long_name": "is known to carry no force"}),
    }
    if record.supports:
        coordinates["support"] = ("support", np.array(record.support_names), {"long_name": "support that moves"})
    described = {"long_name": "connection; what it joins is stretched by its drift"}
    return coordinates | {"connection": ("connection", np.array(connections), described)}


def write_dataset(dataset: xr.Dataset, path: Path | str) -> Path:
    """Write ``dataset`` as netCDF 4 through h5netcdf, variable by variable."""
    with replacing_by_reserved(path, dataset.nbytes + AROUND_DATA) as file:
        dataset.to_netcdf(file, engine="h5netcdf", format="NETCDF4")
    return Path(path)


def netcdf_attributes(given: Mapping[str, object]) -> dict[str, object]:
    """Attributes as netCDF can hold them: no null, no boolean."""
    kept = {name: value for name, value in given.items() if value is not None}
    return {name: int(value) if isinstance(value, bool | np.bool_) else value for name, value in kept.items()}
