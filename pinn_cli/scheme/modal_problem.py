"""The problem of a structure of which a record tells the modes in a band, and what it tells of them.

Which modes a band holds is found one after the other, each where it explains most of what is left.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pinn_cli.record.record import Record
from pinn_cli.scheme.joint_problem import JointProblem
from pinn_cli.scheme.modal_fit import BEYOND, BandModel, BandSpectra, ModalFit, fitted
from pinn_cli.scheme.problem import Problem, SpectralEstimate, inputs_of
from pinn_cli.settings.errors import InputError
from pinn_cli.system.building import ModesSought, modal_structure
from pinn_cli.system.frequency_response import real_rows
from pinn_cli.system.parameters import PRIOR_WIDTH
from pinn_cli.system.quantities import FORCE
from pinn_cli.system.structure import Structure

log = logging.getLogger(__name__)

# Lines of the spectrum that a band has at the least for every mode that is asked for.
LINES_PER_MODE = 8
# Of a mode that hardly moves the driven point, the least residue there over the largest of all sensors.
LEAST_RESIDUE = 1e-3
# Damping ratio of a mode whose frequency somebody gave, and those that are tried.
FIRST_RATIO, RATIOS_TRIED = 0.01, (0.005, 0.02)
# From one frequency that is tried to the next, as a part of it: half the width of the sharpest resonance tried.
SPACING = 0.005
# Two close modes may look like one between them: it is split into two that lie so many of its widths apart.
SPLITS = 0.7, 1.4
# Candidates whose columns are held at once.
TRIED_AT_ONCE = 48
# What a mode more explains at the least, in nepers of what is left: no structure is quite linear, and its spectra quite
# those of modes.
LEAST_EXPLAINED = 0.05


def modal_problem(sought: ModesSought, prescribed: Structure, records: Sequence[Record]) -> JointProblem:
    """Modes of the band that fit a record, as a structure, with what the record tells of their parameters.

    What is prescribed is a structure of :func:`pinn_cli.system.building.build_modal`.

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
        allowed = "one measured force, and nothing else, with system=modal"
        raise InputError("data.force", f"{len(forces)} measured", allowed)
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
        sizes = {p: float(values[p.kind][i]) for p, i in chosen.items()}
        parameters = tuple(
            replace(p, prescribed=size, prior_std=PRIOR_WIDTH * size, scale=size, unknown=True, positive=True)
            for p, size in sizes.items()
        )
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


def searched(spectra: BandSpectra, count: int | None = None, starts: Sequence[float] = ()) -> ModalFit:
    """The modes of a band, from nothing: one after the other, where it explains most of what is left.

    Modes outside the band are added where the record is more probable with them, by Schwarz's criterion; so are those
    in the band without a count. The first ones are looked for at ``starts``, Hz, or wherever they are.
    """
    fit: ModalFit | None = None
    if starts:
        first = np.concatenate((2.0 * np.pi * np.array(starts), np.full(len(starts), FIRST_RATIO)))
        fit = fitted(spectra, np.log(first))
    while True:
        within = 0 if fit is None else int(fit.within.sum())
        lacking = count is not None and within < count
        tried = _starts(spectra, fit, inside=count is None or lacking)
        again = _best(spectra, tried)
        more = int(again.within.sum()) > within and (count is None or lacking)
        if fit is not None and gain(fit, again) <= 0.0 and not (more and lacking):
            return fit
        fit = again


def missing_mode(fit: ModalFit) -> float | None:
    """Frequency, Hz, of a mode more in the band that makes the record more probable; None: there is none."""
    again = _best(fit.spectra, _starts(fit.spectra, fit, inside=True))
    if gain(fit, again) <= 0.0 or again.within.sum() <= fit.within.sum():
        return None
    new = again.frequencies[again.within]
    distance = np.abs(new[:, None] - fit.frequencies[None, fit.within]).min(axis=1)
    return float(new[distance.argmax()])


def _best(spectra: BandSpectra, starts: Sequence[np.ndarray]) -> ModalFit:
    """The most probable one of the modes near several starts."""
    fits = (fitted(spectra, x, rounds=1) for x in starts)
    best = max(fits, key=lambda fit: (fit.is_distinct, fit.log_likelihood))
    return fitted(spectra, best.x, replace(best.noise, force=0.0))


def gain(before: ModalFit, after: ModalFit) -> float:
    """How much more probable a mode more makes the record, its unknowns paid for (Schwarz 1978)."""
    if not after.is_distinct:
        return -np.inf
    lines, sensors = before.residuals.shape
    price = max(0.5 * (2 + 3 * sensors) * np.log(2.0 * lines * sensors), LEAST_EXPLAINED * lines * sensors)
    return after.log_likelihood - before.log_likelihood - price


def _starts(spectra: BandSpectra, fit: ModalFit | None, inside: bool) -> list[np.ndarray]:
    """Unknowns with one mode more: where it explains most of what is left, or the mode nearest to that split in two."""
    x = np.empty(0) if fit is None else fit.x
    new = _candidate(spectra, x, fit, inside)
    starts = [_joined(x, *new)]
    if fit is None or not fit.within.any() or not inside:
        return starts
    within = np.flatnonzero(fit.within)
    nearest = within[np.abs(np.log(2.0 * np.pi * fit.frequencies[within]) - new[0]).argmin()]
    rest = np.delete(x.reshape(2, -1), nearest, axis=1).reshape(-1)
    omega, zeta = x.reshape(2, -1)[:, nearest]
    for widths in SPLITS:
        offset = widths * np.exp(zeta)
        split = _joined(rest, omega - offset, zeta - np.log(2.0))
        starts.append(_joined(split, omega + offset, zeta - np.log(2.0)))
    return starts


def _joined(x: np.ndarray, omega: float, zeta: float) -> np.ndarray:
    """Unknowns with one mode more."""
    return np.column_stack((x.reshape(2, -1), (omega, zeta))).reshape(-1)


def _candidate(spectra: BandSpectra, x: np.ndarray, fit: ModalFit | None, inside: bool) -> tuple[float, float]:
    """Logarithms of the frequency and the damping ratio of the mode that explains most of what x leaves."""
    model = BandModel(spectra)
    weight = np.ones(len(spectra.sensors)) if fit is None else 1.0 / fit.noise.sensors
    low, high = np.log(spectra.band)
    beyond = np.log(BEYOND)
    grid = np.linspace(low - beyond, high + beyond, int((high - low + 2.0 * beyond) / SPACING))
    if not inside:
        grid = grid[(grid < low) | (grid > high)]
    tried = np.array([(f + np.log(2.0 * np.pi), np.log(zeta)) for f in grid for zeta in RATIOS_TRIED])
    basis = [np.linalg.qr(real_rows(columns))[0] for columns in model.columns(x)]
    residuals = [real_rows(y) - q @ (q.T @ real_rows(y)) for y, q in zip(spectra.response.T, basis, strict=True)]
    explained = []
    for some in np.array_split(tried, -(-len(tried) // TRIED_AT_ONCE)):
        by_sensor = zip(model.candidates(some), basis, residuals, weight, strict=True)
        explained.append(sum(f**2 * _explained(columns, q, y) for columns, q, y, f in by_sensor))
    omega, zeta = tried[int(np.concatenate(explained).argmax())]
    return float(omega), float(zeta)


def _explained(columns: np.ndarray, basis: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """(T,), squares of what is left (rows,) that each candidate's columns (T, B, 3) explain beside a basis."""
    new = np.concatenate((columns.real, columns.imag), axis=1)
    new = new - basis @ (basis.T @ new)
    new /= np.linalg.norm(new, axis=1, keepdims=True)
    turned = np.ascontiguousarray(new.transpose(0, 2, 1))
    along = turned @ residual
    gram = turned @ new + 1e-10 * np.eye(new.shape[-1])
    return np.einsum("tc,tc->t", along, np.linalg.solve(gram, along[..., None])[..., 0])
