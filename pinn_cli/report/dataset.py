"""The labelled time histories of a run, ``response.nc``: estimate, deviation, truth and observations, (time, dof)."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from pinn_cli.record.response import GROUND, QUANTITIES, RESPONSE_QUANTITIES, UNITS
from pinn_cli.runs.reserved_file import replacing_by_reserved
from pinn_cli.system.quantities import SUPPORT

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pinn_cli.record.record import Record
    from pinn_cli.record.response import Response
    from pinn_cli.report.connection_forces import ConnectionForces
    from pinn_cli.report.drift import Drifts
    from pinn_cli.training.estimate import Estimate

# Bytes at most of names, attributes and HDF5's own tables.
AROUND_DATA = 2**20


def response_dataset(
    estimate: Estimate,
    record: Record,
    truth: Response | None,
    attributes: Mapping[str, object],
    free_run: Response | None = None,
    baseline: tuple[str, Estimate] | None = None,
    drifts: Drifts | None = None,
    forces: ConnectionForces | None = None,
) -> xr.Dataset:
    """Everything that a figure of the response needs, labelled.

    Args:
        estimate: The estimated response and its standard deviations, (time, dof) each.
        record: What the estimator saw.
        truth: The true response, NaN where unknown; None if nothing is known.
        attributes: Global attributes: text, numbers and booleans; those that are None are left out (netCDF has no
            null).
        free_run: The motion of the estimated system by itself; None where there is none.
        baseline: Name and estimate of another estimator; None where there is none.
        drifts: Of the connections; None: they are left out.
        forces: Of the connections; None: they are left out.

    Returns:
        For each quantity ``displacement`` (estimate), ``displacement_std``, ``displacement_true`` (left out where no
        DOF's truth is known), ``displacement_observed`` (NaN where there is no sensor, and where it has no sample) and
        ``displacement_free_run`` (left out where there is none), and so on for velocity, acceleration and force (which
        has no free run), over ``time`` (s) and ``dof`` (from 1, of a chain nearest the fixed end; ``dof_name`` where
        DOFs have names); last
        ``displacement_<name>`` of the baseline and ``displacement_<name>_std``. Where the ground moves,
        ``ground_acceleration`` and the same of it over ``time``, each left out where there is none. ``drift``,
        ``drift_std`` and, where known, ``drift_true`` over ``time`` and ``connection`` (its name, or its number from
        1). Where supports move, ``support_displacement`` and its derivatives, and the same of these, over ``time`` and
        ``support``. ``observed`` and ``unforced``: DOFs with a response sensor, and those known to carry no force.
    """
    variables: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]] = {}
    for quantity in QUANTITIES:
        sources = {
            "": (getattr(estimate.response, quantity), f"estimated {quantity}"),
            "_std": (getattr(estimate.std, quantity), f"standard deviation of the estimated {quantity}"),
            "_true": (None if truth is None else getattr(truth, quantity), f"true {quantity}"),
            "_observed": (_observed(record, quantity), f"observed {quantity}"),
        }
        if free_run is not None and quantity in RESPONSE_QUANTITIES:
            long_name = f"{quantity} of the estimated system under the measured force"
            sources["_free_run"] = (getattr(free_run, quantity), long_name)
        for suffix, (values, long_name) in sources.items():
            if values is None or (suffix == "_true" and np.isnan(values).all()):
                continue
            described = {"long_name": long_name, "units": UNITS[quantity]}
            variables[quantity + suffix] = (("time", "dof"), values, described)
    for name, other in [baseline] if baseline else []:
        kinds = (("", "", other.response), ("_std", "standard deviation of the ", other.std))
        for quantity, (suffix, words, response) in product(QUANTITIES, kinds):
            described = {"long_name": f"{words}{quantity} estimated by {name}", "units": UNITS[quantity]}
            variables[f"{quantity}_{name}{suffix}"] = (("time", "dof"), getattr(response, quantity), described)
    variables |= _of_the_ground(estimate, record, truth) | _of_the_connections(drifts) | _of_supports(estimate, record)
    variables |= _internal_forces(forces, drifts)
    fixed = {
        "Conventions": "CF-1.11",
        "title": "Estimated response of a structure",
        "intersample": record.intersample,
    }
    if record.ground_acceleration is not None:
        fixed["frame"] = record.frame
    return xr.Dataset(variables, coords=_coordinates(record, drifts), attrs=fixed | netcdf_attributes(attributes))


def _of_the_ground(
    estimate: Estimate, record: Record, truth: Response | None
) -> dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]]:
    """Its acceleration, estimated, true and observed, as far as there is one; see :func:`response_dataset`."""
    observed = None if record.ground_acceleration is None else _observed(record, GROUND)[:, 0]
    sources = {
        "": (estimate.response.ground_acceleration, "estimated ground acceleration"),
        "_std": (estimate.std.ground_acceleration, "standard deviation of the estimated ground acceleration"),
        "_true": (None if truth is None else truth.ground_acceleration, "true ground acceleration"),
        "_observed": (observed, "observed ground acceleration"),
    }
    return {
        GROUND + suffix: (("time",), values, {"long_name": long_name, "units": UNITS[GROUND]})
        for suffix, (values, long_name) in sources.items()
        if values is not None
    }


def _of_supports(estimate: Estimate, record: Record) -> dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]]:
    """Their motion, estimated and observed, where they move; see :func:`response_dataset`."""
    out: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]] = {}
    for order, (name, quantity) in enumerate(SUPPORT.items()):
        sources = {"": (estimate.response.supports, ""), "_std": (estimate.std.supports, "standard deviation of the ")}
        for suffix, (moved, words) in sources.items():
            if moved is not None:
                described = {"long_name": f"{words}estimated {quantity} of the support", "units": UNITS[name]}
                out[name + suffix] = (("time", "support"), moved[:, order], described)
        if name in record.supports:
            described = {"long_name": f"observed {quantity} of the support", "units": UNITS[name]}
            out[f"{name}_observed"] = (("time", "support"), record.supports[name], described)
    return out


def _of_the_connections(drifts: Drifts | None) -> dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]]:
    """Their drifts, estimated and true; see :func:`response_dataset`."""
    if drifts is None:
        return {}
    return _by_connection("drift", "drift", UNITS["displacement"], drifts)


def write_dataset(dataset: xr.Dataset, path: Path | str) -> Path:
    """Write ``dataset`` as netCDF 4 through h5netcdf, variable by variable."""
    with replacing_by_reserved(path, dataset.nbytes + AROUND_DATA) as file:
        dataset.to_netcdf(file, engine="h5netcdf", format="NETCDF4")
    return Path(path)


def netcdf_attributes(given: Mapping[str, object]) -> dict[str, object]:
    """Attributes as netCDF can hold them: no null, no boolean."""
    kept = {name: value for name, value in given.items() if value is not None}
    return {name: int(value) if isinstance(value, bool | np.bool_) else value for name, value in kept.items()}


def _observed(record: Record, quantity: str) -> np.ndarray:
    # A force that is known to be zero is 0 in the record; nobody has measured it.
    shown = np.where(record.sensors(quantity), record.histories(quantity), np.nan)
    return np.where(record.missing[quantity], np.nan, shown) if quantity in record.missing else shown


def _internal_forces(
    forces: ConnectionForces | None, drifts: Drifts | None
) -> dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]]:
    """``connection_force``, ``connection_force_std`` and, where known, ``connection_force_true``; NaN of mere pairs."""
    if forces is None:
        return {}
    pairs = 0 if drifts is None else len(drifts.names) - len(forces.names)
    return _by_connection("connection_force", "internal force", UNITS["force"], forces, pairs)


def _by_connection(
    name: str, words: str, units: str, histories: Drifts | ConnectionForces, without: int = 0
) -> dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, str]]]:
    """Estimate, deviation and, where known, truth of what connections have, NaN of the last ones that are without."""
    sources = {
        name: (histories.estimate, f"estimated {words}"),
        f"{name}_std": (histories.std, f"standard deviation of the estimated {words}"),
        f"{name}_true": (histories.true, f"true {words}"),
    }
    return {
        key: (
            ("time", "connection"),
            np.pad(values, ((0, 0), (0, without)), constant_values=np.nan),
            {"long_name": long_name, "units": units},
        )
        for key, (values, long_name) in sources.items()
        if key != f"{name}_true" or np.isfinite(values).any()
    }


def _coordinates(record: Record, drifts: Drifts | None) -> dict[str, tuple[str, np.ndarray, dict[str, str]]]:
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
    if drifts is not None:
        described = {"long_name": "connection; what it joins is stretched by its drift"}
        coordinates["connection"] = ("connection", np.array(drifts.names), described)
    return coordinates
