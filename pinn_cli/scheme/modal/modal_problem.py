"""The problem of a structure of which a record tells the modes in a band, and what it tells of them."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pinn_cli.record.record import Record
from pinn_cli.scheme.inputs import inputs_of
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.modal.modal_fit import BandSpectra, ModalFit
from pinn_cli.scheme.modal.modal_search import missing_mode, searched
from pinn_cli.scheme.problem import Problem, SpectralEstimate
from pinn_cli.settings.errors import InputError
from pinn_cli.system.building import ModesSought, modal_structure
from pinn_cli.system.parameters import PRIOR_WIDTH, Parameter
from pinn_cli.system.quantities import FORCE
from pinn_cli.system.structure import Structure

log = logging.getLogger(__name__)

# Lines of the spectrum that a band has at the least for every mode that is asked for.
LINES_PER_MODE = 8
# Of a mode that hardly moves the driven point, the least residue there over the largest of all sensors.
LEAST_RESIDUE = 1e-3


def modal_problem(sought: ModesSought, prescribed: Structure, records: Sequence[Record]) -> JointProblem:
    """Modes of the band that fit a record, as a structure, with what the record tells of their parameters.

    Args:
        sought: Which modes are asked for.
        prescribed: See :func:`pinn_cli.system.building.build_modal`.
        records: One.

    Raises:
        InputError: More than one record; no band; not one measured force alone; a band that is too narrow.
    """
    record, driven = _checked(records)
    spectra = BandSpectra.of(record, driven)
    low, high = spectra.band
    least = LINES_PER_MODE * (1 + (sought.count or 1))
    if (high - low) * record.duration < least:
        allowed = f"a band of {least / record.duration:.3g} Hz, or a longer record"
        hint = f"{record.duration:.4g} s tell {(high - low) * record.duration:.0f} lines of it apart"
        raise InputError("data.band", [low, high], allowed, hint)
    for start in sought.starts:
        if not low < start < high:
            raise InputError("system.modes", start, f"frequencies within data.band=[{low:g}, {high:g}]")
    fit = searched(spectra, sought.count, sought.starts)
    structure, estimate = _Modes(fit, driven).structure(prescribed)
    if sought.count is not None and fit.within.sum() < sought.count:
        log.warning("data.band shows %d modes, and system.modes asks for %d", fit.within.sum(), sought.count)
    inputs = inputs_of(structure, record)
    return JointProblem.of(Problem(structure, record, estimate.parameters, inputs=inputs, spectral=estimate))


def _checked(records: Sequence[Record]) -> tuple[Record, int]:
    """The record, and the DOF, from 0, on which its force acts."""
    if len(records) > 1:
        raise InputError("data.records", f"{len(records)} records", "one record with system=modal")
    record = records[0]
    if record.band is None:
        raise InputError("data.band", None, "given with system=modal, Hz, such as [4, 12]")
    forces = np.flatnonzero(record.sensors("force"))
    moved = record.ground_acceleration is not None or bool(record.supports)
    if len(forces) != 1 or (~record.unforced).sum() != 1 or moved:
        raise InputError(
            "data.force", f"{len(forces)} measured", "one measured force, and nothing else, with system=modal"
        )
    silent = np.flatnonzero(~record.observed & record.unforced)
    if len(silent):
        hint = "a record tells nothing of other points (data.holdout)"
        raise InputError("system.dofs", record.dof_names(silent), "points with a sensor or the force", hint)
    if record.calibrated:
        names = ", ".join(channel.key for channel in record.calibrated)
        raise InputError("data.channels", names, "calibrated sensors of one DOF each with system=modal")
    return record, int(forces[0])


@dataclass(frozen=True, eq=False)
class _Modes:
    """Modes that were found, as masses, dampers and springs.

    A residue is shape(sensor) shape(force) / mass. The driven point's shape is one: the mass is that which the force
    feels. Where no sensor is there, the shape of the sensor with the largest residue is one too.
    """

    fit: ModalFit
    driven: int

    def structure(self, prescribed: Structure) -> tuple[Structure, SpectralEstimate]:
        """With the estimate of the parameters of the modes in the band."""
        fit, inside = self.fit, self.fit.within
        omega, zeta = fit.every_mode
        band = np.append(inside, [False, False])
        below = ~band & (omega <= 2.0 * np.pi * fit.spectra.band[0])
        below |= ~band & ~below & (np.append(fit.frequencies, [0.0, np.inf]) < np.mean(fit.spectra.band))
        order = np.concatenate([np.flatnonzero(x) for x in (band, below, ~band & ~below)])
        mass, reference = self._masses()
        shapes = np.zeros((prescribed.ndof, len(omega)))
        for (_, dof), residues in zip(fit.spectra.sensors, fit.residues, strict=True):
            shapes[dof] = residues * mass
        shapes[self.driven] = 1.0
        values = mass, 2.0 * zeta * omega * mass, omega**2 * mass
        made = modal_structure(
            prescribed.labels.dofs, shapes[:, order], tuple(x[order] for x in values),
            (int(below.sum()), int((~band & ~below).sum())),
        )  # fmt: skip
        return made, self._estimate(made, np.flatnonzero(inside), reference)

    def _masses(self) -> tuple[np.ndarray, np.ndarray]:
        """(R + 2,), kg, and of every mode the sensor that tells it."""
        residues = np.abs(self.fit.residues)
        collocated = [i for i, (_, dof) in enumerate(self.fit.spectra.sensors) if dof == self.driven]
        largest = residues.argmax(axis=0)
        if not collocated:
            return 1.0 / residues[largest, range(len(largest))], largest
        driving_point = self.fit.residues[collocated[0]]
        mass = 1.0 / np.maximum(driving_point, LEAST_RESIDUE * residues.max(axis=0))
        return mass, np.full(len(largest), collocated[0])

    def _estimate(self, made: Structure, modes: np.ndarray, reference: np.ndarray) -> SpectralEstimate:
        """Of the parameters of modes in the band."""
        fit, count = self.fit, len(self.fit.frequencies)
        values = made.parameters_like(np.empty(0))
        chosen = {p: p.index for p in made.every_parameter() if p.index < len(modes)}
        slopes = np.zeros((len(chosen), len(fit.covariance)))
        for row, (p, i) in enumerate(chosen.items()):
            mode, value = modes[i], float(values[p.kind][i])
            residue = fit.residues[reference[mode], mode]
            if abs(residue) * values["m"][i] > 0.5:  # else the mass is at its limit
                slopes[row, 2 * count + reference[mode] * count + mode] = -value / residue
            slopes[row, mode] = {"m": 0.0, "c": 1.0, "k": 2.0}[p.kind] * value
            slopes[row, count + mode] = value if p.kind == "c" else 0.0
        parameters = tuple(_unknown(p, float(values[p.kind][i])) for p, i in chosen.items())
        std = np.sqrt(fit.excess[modes[list(chosen.values())]])
        covariance = np.outer(std, std) * (slopes @ fit.covariance @ slopes.T)
        levels = self._levels(made.ndof)
        return SpectralEstimate(parameters, covariance, fit.log_likelihood, levels, fit.misfit, missing_mode(fit))

    def _levels(self, dofs: int) -> dict[str, np.ndarray]:
        """White noise of every sensor, the load cell's included: what else disturbs the motion is added to that."""
        fit, nothing = self.fit, np.full(dofs, np.nan)
        levels = {quantity: nothing.copy() for quantity in (FORCE, *(q for q, _ in fit.spectra.sensors))}
        of_line = np.sqrt(fit.spectra.samples)
        for (quantity, dof), level in zip(fit.spectra.sensors, fit.noise.sensors * fit.spectra.scale, strict=True):
            levels[quantity][dof] = level / of_line
        rms = np.sqrt(np.mean(np.abs(fit.spectra.force) ** 2))
        levels[FORCE][self.driven] = fit.noise.force * rms / of_line
        return levels


def _unknown(parameter: Parameter, value: float) -> Parameter:
    return replace(
        parameter, prescribed=value, prior_std=PRIOR_WIDTH * value, scale=value, unknown=True, positive=True
    )  # fmt: skip
