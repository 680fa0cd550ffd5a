"""What acts: forces that nobody measured, what samples leave open of those that were, connections with memory."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.between_samples import FIRST_ORDER_HOLD, held_by_lines
from pinn_cli.record.channels import channels
from pinn_cli.record.free_run import is_linear
from pinn_cli.record.identification.modes import identify
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.record.spectrum import reaches_nyquist
from pinn_cli.system.modes import modes_of
from pinn_cli.system.parameters import MASS, Parameter
from pinn_cli.system.quantities import FORCE, GROUND, SUPPORT
from pinn_cli.verdict.finding import Finding, failed_if
from pinn_cli.verdict.prediction import predicted

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pinn_cli.record.record import Record
    from pinn_cli.scheme.problem import Problem, SpectralEstimate
    from pinn_cli.system.structure import Structure
    from pinn_cli.training.estimate import Estimate


# Rms of a displacement's standard deviation over that of the displacement: from here on nobody knows it.
UNTOLD = 0.5
# A mode that is this part of the motion at its peak is a clear one; a natural frequency further from it, relative, is
# another one's; so many are named.
CLEAR, ELSEWHERE, PEAKS_NAMED = 0.9, 0.1, 6
# Part of the power of the sensors' spectra, in a part of the band, that a model may miss beyond chance.
MISSED = 0.3
# Part of the power of the sensors in a part of the band that modes with a measured force may leave beyond noise.
LEFT_OF_POWER = 0.05
# Standard deviations by which the responses to two motions with the same samples differ, all samples together: by so
# many a record would tell them apart.
TOLD_APART = 5.0
# The upper end of a spectrum, over the Nyquist frequency, and the part of a force's power there that is no noise of a
# load cell: a white force has a tenth of its power in it.
UPPER_END, FORCE_MATTERS = 0.9, 0.02


def input_findings(problem: Problem, estimate: Estimate, structure: Structure) -> list[Finding]:
    """Every finding about what acts but those of :func:`sampling_findings` and :func:`resonance_findings`.

    The structure has the estimated parameters.
    """
    if problem.spectral is not None:
        return [*_of_modes(problem.record, problem.spectral)]
    return [
        *_output_only(problem),
        *_spectra(estimate),
        *_under_forces(problem, estimate),
        *_untold(problem, estimate),
        *_energy(structure),
    ]


def _untold(problem: Problem, estimate: Estimate) -> Iterator[Finding]:
    """DOFs whose displacement the forces that nobody measured leave open."""
    std, motion = (np.sqrt(np.mean(x.displacement**2, axis=0)) for x in (estimate.std, estimate.response))
    open_dofs = np.flatnonzero(std > UNTOLD * motion)
    if problem.inputs.unmeasured and open_dofs.size:
        worst = 100.0 * float(np.max(std[open_dofs] / np.maximum(motion[open_dofs], np.finfo(float).tiny)))
        names = problem.record.dof_names(open_dofs.tolist())
        extent = f"its standard deviation is up to {worst:.0f} % of it; put sensors there, or measure the forces"
        yield Finding("untold", names, f"unmeasured forces leave the displacement of {names} open: {extent}")


def _of_modes(record: Record, spectral: SpectralEstimate) -> Iterator[Finding]:
    """A driven point whose motion no sensor shows; what the spectra of a band show beside the modes that were found."""
    dofs = np.flatnonzero(record.sensors("force") & ~record.observed)
    if len(dofs):
        text = (
            f"no sensor is where the force acts, at {record.dof_names(dofs)}: what is shown of its motion is not to"
            " scale, and every modal mass belongs to the sensor that moves most in its mode"
        )
        yield Finding("driven", record.dof_names(dofs), text, "sound")
    if spectral.missing is not None:
        text = f"a mode at {spectral.missing:.4g} Hz is in the band and not in the model"
        yield Finding("missing_mode", "system.modes", f"{text}; ask for more (system.modes)")
    elif spectral.misfit > LEFT_OF_POWER:
        share = f"{100.0 * spectral.misfit:.0f} %"
        text = (
            f"in a part of the band the modes leave {share} of the sensors' power, more than noise does; frequencies"
            " may be right, damping and masses not; check the force, the sensors and whether the level matters"
        )
        yield Finding("spectra", "parameters", text)


def _spectra(estimate: Estimate) -> Iterator[Finding]:
    """A structure under unknown forces that does not show what the sensors show."""
    misfit = float(estimate.summary.get("spectral_misfit", 0.0))
    if misfit > MISSED:
        text = (
            "under unmeasured forces of any smooth spectrum the estimated structure does not show the spectra of the"
            f" sensors: in a part of the band their power is {100.0 * misfit:.0f} % off; do not trust parameters and"
            " intervals; check masses, sensors, connections, and whether forces have lines"
        )
        yield Finding("spectra", "parameters", text)


def resonance_findings(problem: Problem, structure: Structure) -> list[Finding]:
    """Resonances that the sensors show by themselves, and that the estimated structure does not have.

    Under what was measured of all that acts, they are those of the response to it.
    """
    record, unmeasured = problem.record, problem.inputs.unmeasured
    if not is_linear(structure):
        return []
    moving, acting = (
        [channel.measured for channel in channels(record, of) if np.ptp(channel.measured) > 0]
        for of in (RESPONSE_QUANTITIES, () if unmeasured else (FORCE, GROUND, *SUPPORT))
    )
    if not moving or not (acting or unmeasured):
        return []
    inputs = np.reshape(acting, (len(acting), len(record.time))).T
    clear = [mode for mode in identify(np.stack(moving, axis=1), inputs, record.step).modes if mode.explained > CLEAR]
    natural = modes_of(structure).natural_frequencies
    natural = natural[natural > 0]
    off = [p for p in clear if np.abs(natural - p.frequency).min(initial=np.inf) > ELSEWHERE * p.frequency]
    if not off:
        return []
    shown = ", ".join(f"{p.frequency:.4g}" for p in off)
    having = ", ".join(f"{f:.4g}" for f in natural[:PEAKS_NAMED])
    text = f"the sensors show resonances at {shown} Hz, and the estimated structure has none there (it has {having} Hz)"
    remedy = "start elsewhere (scheme.initial), check masses and sensors, or whether a machine runs at that frequency"
    return [Finding("resonances", "parameters", f"{text}; {remedy}", failed_if(len(off) == len(clear)))]


def _output_only(problem: Problem) -> Iterator[Finding]:
    """Nothing that acts was measured: all that a record tells is relative."""
    record = problem.record
    measured = record.sensors("force").any() or record.measured_ground is not None or record.supports
    if not measured and record.unmeasured:
        text = (
            "no force was measured: the record tells frequencies, damping and shapes, but no absolute mass or"
            " stiffness; forces, and every stiffness, are as right as the prescribed masses"
        )
        yield Finding("output_only", "force", text, "sound")


def _under_forces(problem: Problem, estimate: Estimate) -> Iterator[Finding]:
    """Parameters that were found together with the most probable unknown forces, and not with these integrated out.

    What no equation holds, see :func:`_unheld`, is held by the spectrum of the forces alone. It does where this is the
    one that the record shows, and a sensor is wherever a force acts (a storey next to the ground, whose motion nobody
    measured, came out 30 to 50 % too soft).
    """
    summary = estimate.summary
    if not problem.uncertain or not problem.inputs.unmeasured or "spectral_misfit" in summary:
        return
    is_integrated = summary.get("at_marginal_peak", False)
    is_shown = summary.get("misfit_unknown_force", np.inf) <= MISSED and not problem.structure.is_modal
    if is_integrated and is_shown and problem.record.observed[list(problem.inputs.forces)].all():
        return
    unheld = _unheld(problem)
    some_are_held = len(unheld) < len(problem.uncertain)
    if unheld and some_are_held:
        names = ", ".join(unheld)
        text = f"of {names} nothing is known but through the spectrum of a force that was not measured"
        remedy = "do not trust them and their intervals; measure the force, or prescribe them"
        yield Finding("output_only_parameters", names, f"{text}: {remedy}")
    if not (some_are_held and is_integrated):
        text = (
            "some forces were not measured, parameters were uncertain, and the record was explained with the most"
            " probable forces, not with all that are possible: damping comes out too small then, stiffnesses up to some"
            " per cent off, and intervals too narrow; measure the forces, or prescribe the parameters"
            " (scheme.parameter_uncertainty=0)"
        )
        yield Finding("output_only_parameters", "parameters", text)


def _unheld(problem: Problem) -> list[str]:
    """Names of the parameters in no equation without an unknown force, of a motion that sensors tell.

    Such a force, on a DOF with a sensor, leaves the DOFs on its two sides with nothing in common. A part that has no
    sensor of its own has no more equations than motions that nobody measured.
    """
    from scipy.sparse.csgraph import connected_components

    structure, observed = problem.structure, problem.record.observed
    forces = _unmeasured_forces(problem)
    free = np.setdiff1d(np.arange(problem.record.ndof), forces)
    if structure.is_modal or not len(free) or not observed[forces].all():
        return [p.name for p in problem.uncertain]
    stretch = abs(structure.incidence.matrix)
    _, part = connected_components(stretch[:, free].T @ stretch[:, free], directed=False)
    sensed = np.zeros(problem.record.ndof, dtype=bool)
    sensed[free] = np.isin(part, part[observed[free]])

    def is_held(p: Parameter) -> bool:
        if p.kind in structure.carriers:
            connections, which = structure.carriers[p.kind]
            return bool(sensed[stretch[connections[which == p.index]].nonzero()[1]].any())
        return p.kind != MASS or bool(sensed[p.index])

    return [p.name for p in problem.uncertain if not is_held(p)]


def _unmeasured_forces(problem: Problem) -> np.ndarray:
    """DOFs, from 0, on which a force acts that nobody measured.

    To what moves relative to a ground that nobody measured its motion is one force on all masses, which two equations
    have in common; to accelerometers that feel it as well, a force where connections join the ground.
    """
    record, structure = problem.record, problem.structure
    if not record.misses_ground:
        return np.array(problem.inputs.forces, dtype=int)
    felt = ("displacement", "velocity") if problem.inputs.absolute else RESPONSE_QUANTITIES
    relative = np.any([record.sensors(quantity) for quantity in felt], axis=0)
    if relative.sum() > 1:
        return np.zeros(0, dtype=int)
    stretch = structure.incidence.matrix
    joined = np.abs(stretch @ structure.with_ground) > 0.0
    return np.flatnonzero(abs(stretch[joined]).sum(axis=0).A1)


def _energy(structure: Structure) -> Iterator[Finding]:
    """Connections with memory whose parameters allow them to create energy."""
    for connection in np.flatnonzero(structure.creates_energy()).tolist():
        name, law = structure.labels.connection(connection), structure.laws[connection].name
        text = f"the hysteresis of connection {name} ({law}) can create energy with its parameters;"
        text += " where the record's amplitudes do not go, do not trust it"
        yield Finding("energy", f"connection {name}", text, "sound")


def sampling_findings(problem: Problem, estimate: Estimate, structure: Structure) -> list[Finding]:
    """What the samples of forces and of the ground leave open, and nobody said."""
    return [*_rare_forces(problem.record), *_rare_ground(problem.record, estimate, structure)]


def _rare_forces(record: Record) -> Iterator[Finding]:
    """Forces with content up to the Nyquist frequency, such as white ones, where nobody said how they go on."""
    for channel in channels(record, (FORCE,)) if record.assumed else ():
        # No window: one would take a hammer's blow, early in its record, for less than the noise after it.
        power = np.abs(np.fft.rfft(channel.measured - channel.measured.mean())) ** 2
        share = float(power[int(UPPER_END * len(power)) :].sum() / power.sum()) if power.any() else 0.0
        if share < FORCE_MATTERS:
            continue
        text = (
            f"the {channel.name} has content up to the Nyquist frequency, {0.5 / record.step:.4g} Hz: what acts between"
            " its samples is not known, and intervals may be too narrow"
        )
        remedy = "sample faster, or say what it does: data.intersample=zero_order_hold, first_order_hold, band_limited"
        yield Finding("intersample", channel.name, f"{text}; {remedy}")


def _rare_ground(record: Record, estimate: Estimate, structure: Structure) -> Iterator[Finding]:
    """That straight lines between the ground's samples would shake the structure differently, and nobody said."""
    ground = record.measured_ground
    if ground is None or not record.assumed or not is_linear(structure):
        return
    (channel,) = channels(record, (GROUND,))
    if not reaches_nyquist(ground, record.step, float(np.nan_to_num(estimate.noise.of(channel)))):
        return
    held = replace(record, ground_acceleration=held_by_lines(ground))
    first, second = predicted(structure, record), predicted(structure, held)
    if first is None or second is None:
        return
    between = {c: float(np.linalg.norm(c.of(first.response) - c.of(second.response))) for c in channels(record)}
    # Of the sensor that tells most, in its standard deviations.
    if any(far / noise >= TOLD_APART for c, far in between.items() if (noise := estimate.noise.of(c)) > 0):
        text = (
            f"the ground's acceleration has content up to the Nyquist frequency, {0.5 / record.step:.4g} Hz, and how it"
            " goes on between its samples changes the response by more than the sensors' noise hides"
        )
        remedy = f"say what it does: data.intersample=band_limited, or {FIRST_ORDER_HOLD} if straight lines join them"
        yield Finding("intersample", "ground", f"{text}; {remedy}")
