"""Causes: what makes a linear structure do under the measured force what every sensor measured.

A fault of a channel, of the time axis or of the model is a record that is put right in one way, or a number that was
held and is free. With each of them the structure is fitted to the cross spectra of what acts and of the sensors
(:mod:`pinn_cli.scheme.linear_fit`). That with which the record is most probable is told, if it explains most of what
the structure misses without it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.channel import Channel
from pinn_cli.record.channels import channels
from pinn_cli.scheme.calibration import doubts_about
from pinn_cli.scheme.linear_fit import WIDTHS, JointFit, LinearFit, LinearStructure, what_acts
from pinn_cli.scheme.screening import Candidate, grid_of_starts, nearest
from pinn_cli.scheme.starts import linear_parts
from pinn_cli.system.connection.linear import Linear
from pinn_cli.system.frequency_response import real_rows
from pinn_cli.system.parameters import FACTOR, MASS, Parameter
from pinn_cli.system.quantities import FORCE, GROUND
from pinn_cli.verdict.channel_faults import factor_finding, late_finding, misplaced_finding, swap_finding
from pinn_cli.verdict.finding import Finding

if TYPE_CHECKING:
    from pinn_cli.record.record import Record
    from pinn_cli.scheme.problem import Problem
    from pinn_cli.system.structure import Structure

# Seconds that the unit of the time axis may be long.
SECONDS = {1e-3: "milliseconds", 1e-6: "microseconds", 1e3: "thousands of seconds", 60.0: "minutes", 1 / 60: "1/60 s"}
# Part of the cross spectra that a structure may miss and need no cause; what a cause may leave of it, and of what is
# missed without it.
NEEDS_NO_CAUSE, LEFT, EXPLAINED = 0.01, 0.3, 0.5
# Logarithm of how many times as probable a record must be with one cause as with another, and of what is chance.
DECISIVE_CAUSE, AS_PROBABLE = 5.0, 0.5
# Sensors that are suspected, those that are missed most; and numbers of the structure, those whose slopes explain most.
SUSPECTED = 5
# Standard deviation, as a logarithm, of how far off what a person says is where it is wrong.
WRONG = 1.5
# A factor that is nearer to one is no mistake of a person's; neither is a shorter delay, in samples.
LEAST_FACTOR, LEAST_DELAY_CAUSE = 1.1, 0.5
# Part of itself to which a fit to spectra tells a factor.
TOLD_WITHIN = 0.01
# Part of itself by which an unknown stiffness or mass is another one with a cause.
OTHER_VALUE = 0.02
# A dense matrix is inverted at every frequency, for every cause.
MOST_INVERTED = 24
# Starts of each cause that go on to each width of the smoothing; at first one, which tells which causes are followed.
AT_FIRST, CAUSE_SURVIVORS, FOLLOWED = (1,), (2, 1, 1), 8


@dataclass(frozen=True, eq=False)
class Cause:
    """What may be wrong.

    Attributes:
        record: Put right.
        finding: The finding, of the structure that was fitted with it; None: then it is none.
        factor: How many times what was said what is free comes out, of that structure.
        doubted: Channel whose gain and delay are free.
        free: Kind and places of masses, dampers or springs that are held; dampers have one ratio.
    """

    record: Record
    finding: Callable[[Candidate], Finding | None]
    factor: Callable[[Candidate], float] = lambda _: 1.0
    doubted: Channel | None = None
    free: tuple[str, Sequence[int]] = (MASS, ())


def causes(
    problem: Problem,
    believed: Structure,
    estimated: Structure,
    excused: Sequence[str] = (),
    needs_no_cause: float = NEEDS_NO_CAUSE,
) -> list[Finding]:
    """The most probable cause; none where the structure misses little, or where none explains most of that.

    Args:
        problem: Whose structure does not do what was measured.
        believed: What was said of it. Of a nonlinear one the linear part is looked at.
        estimated: Where what is unknown of it is looked for first; then, where the estimate's own search began.
        excused: Names of channels whose fault is known already.
        needs_no_cause: Part of the cross spectra that the structure may miss.
    """
    record = _in_columns(problem.record, excused)
    if record is None or believed.coordinates > MOST_INVERTED:
        return []
    unknown = [p for p in problem.uncertain if p.unknown]
    searched = any(p.kind in (MASS, "k", FACTOR) for p in unknown)
    begun = (estimated, problem.structure) if searched else (estimated,)
    known = linear_parts(believed, unknown)
    # What comes nearest to a connection that is not linear is nobody's number.
    bent = [i for i, law in enumerate(believed.laws) if not isinstance(law, Linear)]
    # Spectra that are smoothed widely tell causes, and no values.
    sought = [] if bent or believed.is_modal else [p for p in unknown if p.kind in (MASS, "k")]
    for kind in ("c", "k"):
        known[kind][bent] = np.nan
    fits = _Fits(believed, known, begun, bool(bent))
    without, _ = fits.fitted(Cause(record, lambda _: None))
    if without.misfit < needs_no_cause:
        return []
    # What a law takes out of the motion is no damper's.
    dampers = [] if bent else np.flatnonzero(~np.isnan(fits.known["c"])).tolist()
    asked = list(every_cause(believed, record, *fits.suspects(record, without), dampers))
    roughly = np.array([fits.fitted(cause, AT_FIRST)[1] for cause in asked])
    most, explained = min(LEFT, EXPLAINED * without.misfit), []
    for i in sorted(np.argsort(roughly)[:FOLLOWED].tolist()):
        fitted, minus_log = fits.fitted(asked[i])
        finding = asked[i].finding(fitted) if fitted.misfit < most else None
        if finding is not None:
            would = _would_be(sought, estimated, fitted)
            explained.append((minus_log, replace(finding, text=finding.text + would)))
    return _most_probable(explained)


def _in_columns(record: Record, excused: Sequence[str]) -> Record | None:
    """The record as it looks, without sensors that are excused or in doubt; None: it tells nothing."""
    acts = record.force.any() or record.measured_ground is not None or record.supports
    doubted = [c for c in record.calibrated if not (c.number("gain").is_known and c.number("delay").is_known)]
    without = {channel.name for channel in doubted} | set(excused)

    def stays(channel: Channel) -> bool:
        return channel.is_input or channel.name not in without

    if not acts or not any(map(stays, channels(record))) or any(channel.is_input for channel in doubted):
        return None
    kept = replace(record.only(stays), calibrated=(), corrected=())
    return kept if what_acts(kept) else None


def _would_be(sought: Sequence[Parameter], estimated: Structure, fitted: Candidate) -> str:
    """What masses and stiffnesses come out as with a cause, where they are others than what is reported."""
    reported, others = linear_parts(estimated, ()), []
    for p in sought:
        value, now = (float(values[p.kind][p.index]) for values in (fitted.parameters, reported))
        if abs(value - now) > OTHER_VALUE * abs(now):
            others.append(f"{p.name} = {value:.3g}")
    return f"; then {', '.join(others)} instead of what is reported" if others else ""


def _most_probable(explained: list[tuple[float, Finding]]) -> list[Finding]:
    """The most probable one, and beside what else it is."""
    if not explained:
        return []
    least = min(minus_log for minus_log, _ in explained)
    # Sensors come before what acts.
    best = next(finding for minus_log, finding in explained if minus_log < least + AS_PROBABLE)
    as_well = (finding.suspect for minus_log, finding in explained if minus_log < least + DECISIVE_CAUSE)
    suspects = [suspect for suspect in dict.fromkeys(as_well) if suspect != best.suspect]
    said = f"; or something is wrong with the {', the '.join(suspects)}, which explains it as well" if suspects else ""
    return [replace(best, text=best.text + said)]


@dataclass(frozen=True, eq=False)
class _Fits:
    """Fits of one structure.

    Attributes:
        structure: As it was told.
        known: ``m``, ``c``, ``k``, ``loss``, NaN where unknown.
        begun: Where the unknown ones start; a fault may have led each of them astray.
        bends: Whether it is not linear.
    """

    structure: Structure
    known: dict[str, np.ndarray]
    begun: Sequence[Structure]
    bends: bool

    @cached_property
    def guesses(self) -> list[dict[str, np.ndarray]]:
        """``m`` and ``k`` where the fits start: as given, and, of several, all alike, which no fault has put askew."""
        given = [{kind: _sizes(linear_parts(structure, ())[kind]) for kind in (MASS, "k")} for structure in self.begun]
        alike = {}
        for kind, sizes in given[0].items():
            free = np.isnan(self.known[kind])
            alike[kind] = np.where(free, np.exp(np.log(sizes[free]).mean()) if free.any() else 1.0, sizes)
        return [*given, alike] if len(given) > 1 else given

    def fitted(self, cause: Cause, survivors: Sequence[int] = CAUSE_SURVIVORS) -> tuple[Candidate, float]:
        """The structure that comes nearest to the record, and minus the logarithm of the record's probability."""
        known, (kind, places) = {kind: values.copy() for kind, values in self.known.items()}, cause.free
        known[kind][list(places)] = np.nan
        fit = self._fit(cause.record, known, cause.doubted)
        model, widths = JointFit([fit]), self.widths(fit)
        if self.structure.is_modal:  # nobody updates finite elements that are wrong by orders of magnitude
            starts = [model.start(guess[MASS], guess["k"]) for guess in self.guesses]
        else:
            starts = [x for guess in self.guesses for x in grid_of_starts(model, [cause.record], guess)]
        candidate = nearest(model, starts, survivors, widths)[0]
        values, off = fit.common.size, np.log(abs(cause.factor(candidate))) / WRONG
        numbers = 2 * (cause.doubted is not None) + len(places[:1])
        minus_log = values * np.log(max(candidate.misfit, 1e-12)) + numbers * np.log(values) + off**2
        return candidate, 0.5 * float(minus_log)

    def widths(self, fit: LinearFit) -> list[float]:
        """Those of the smoothing at which spectra are those of a structure that is linear, one after the other.

        Smoothed over a relative width w a product of spectra holds what a motion does within 1 / (2 pi w) of its
        periods. Of a record of P periods as large a part is cut off. Resonances that move are as wide as they move.
        Of masses and springs all widths are asked: which of them is wrong only narrow ones tell.
        """
        if not self.structure.is_modal and not self.bends:
            return list(WIDTHS)
        kept = list(WIDTHS[:1])
        for width in () if self.bends else WIDTHS[1:]:
            fit.smooth(width)
            periods = fit.kernel @ fit.spectra.frequency * fit.duration
            size = np.sum(np.abs(fit.common) ** 2, axis=(1, 2))
            if float(size @ np.minimum(1.0, (2.0 * np.pi * width * periods) ** -2.0)) < NEEDS_NO_CAUSE * fit.size:
                kept.append(width)
        fit.smooth(WIDTHS[0])
        return kept

    def suspects(self, record: Record, candidate: Candidate) -> tuple[list[Channel], list[Parameter]]:
        """Sensors of which a structure misses most; held masses and springs that explain most, by their scores."""
        given = [p for p in self.structure.every_parameter() if p.prescribed > 0 and _is_prescribed(self.structure, p)]
        places = [_place(self.structure, p) for p in given]
        known = {kind: candidate.parameters[kind].copy() for kind in self.known}
        for kind, index in places:
            known[kind][index] = np.nan
        fit = self._fit(record, known)
        fit.smooth(self.widths(fit)[-1])
        x = fit.structure.start(candidate.parameters[MASS], candidate.parameters["k"])
        residual, slopes = fit.residual(x), fit.slopes(x) if len(x) else np.empty(0)
        missed = (np.abs(residual) ** 2).sum((0, 2))
        worst = sorted(np.argsort(-missed, kind="stable")[:SUSPECTED].tolist())
        columns, rest = real_rows(slopes.reshape(residual.size, -1)), real_rows(residual.reshape(-1))
        held = np.array([not np.isnan(self.known[kind][index]) for kind, index in places], dtype=bool)
        basis, _ = np.linalg.qr(columns[:, ~held])
        independent = columns[:, held] - basis @ (basis.T @ columns[:, held])
        explained = (independent.T @ rest) ** 2 / np.maximum((independent**2).sum(axis=0), 1e-300)
        doubtful = [p for p, is_held in zip(given, held, strict=True) if is_held]
        most = [doubtful[i] for i in np.argsort(-explained)[:SUSPECTED]]
        return [fit.spectra.sensors[i] for i in worst], most

    def _fit(self, record: Record, known: dict[str, np.ndarray], doubted: Channel | None = None) -> LinearFit:
        """Of the record's spectra."""
        structure = LinearStructure(self.structure, known, self.guesses[0]["k"])
        return LinearFit(record, structure, [] if doubted is None else doubts_about(doubted, record.step))


def _is_prescribed(structure: Structure, parameter: Parameter) -> bool:
    """Whether it is a mass or a stiffness that somebody wrote down: those of modes are the model's."""
    if parameter.kind == FACTOR or not structure.is_modal:
        return parameter.kind in (MASS, "k", FACTOR)
    return parameter.kind == "k" and parameter.index in structure.added


def _place(structure: Structure, parameter: Parameter) -> tuple[str, int]:
    """Kind and place in the fits, see :func:`linear_parts`."""
    if parameter.kind == FACTOR:
        return "k", len(structure.parameters["k"]) + parameter.index
    return parameter.kind, parameter.index


def _sizes(values: np.ndarray) -> np.ndarray:
    """What is not zero, and of what is that of the others."""
    sizes = np.abs(values)
    return np.where(sizes > 0, sizes, np.median(sizes[sizes > 0]) if sizes.any() else 1.0)


def every_cause(
    structure: Structure,
    record: Record,
    sensors: Sequence[Channel],
    held: Sequence[Parameter],
    dampers: Sequence[int],
) -> Iterator[Cause]:
    """All that are asked, of suspected sensors, of masses and springs that are held, and of dampers that are."""
    acting = [*channels(record, (FORCE,)), *channels(record, (GROUND,))]
    for seconds in SECONDS:
        reason = f"the structure does what was measured if the time is in {SECONDS[seconds]}"
        finding = Finding("time_unit", "time", f"{reason}; multiply the time column by {seconds:.6g}", "failed")
        yield Cause(replace(record, time=record.time * seconds), _always(finding))
    for channel in (*sensors, *acting):
        yield _calibrated(record, channel, 1.0)
        yield _calibrated(record.showing([replace(channel, measured=-channel.measured)]), channel, -1.0)
    for first, second in combinations(sensors, 2):
        if first.quantity == second.quantity:
            exchanged = replace(first, measured=second.measured), replace(second, measured=first.measured)
            yield Cause(record.showing(exchanged), _always(swap_finding(first, second)))
    for channel in (*sensors, *channels(record, (FORCE,))):
        for dof in range(record.ndof):
            if not record.sensors(channel.quantity)[dof]:
                yield Cause(_moved(record, channel, dof), _always(misplaced_finding(channel, record.dof_name(dof))))
    for parameter in held:
        yield _other(record, structure, parameter)
    if dampers and not structure.is_damped_as_whole:
        yield _damping(record, structure, dampers)


def _moved(record: Record, channel: Channel, dof: int) -> Record:
    """With a channel on another DOF, from 0."""
    values, unforced = getattr(record, channel.quantity).copy(), record.unforced.copy()
    values[:, dof] = channel.measured
    if channel.quantity == FORCE:
        values[:, channel.dof], unforced[[channel.dof, dof]] = 0.0, (True, False)
    else:
        values[:, channel.dof] = np.nan
    return replace(record, **{channel.quantity: values}, unforced=unforced)


def _always(finding: Finding) -> Callable[[Candidate], Finding]:
    return lambda _: finding


def _calibrated(record: Record, channel: Channel, sign: float) -> Cause:
    """A channel has a gain, or a delay."""

    def gain(candidate: Candidate) -> float:
        return sign * candidate.calibration[channel.name]["gain"]

    def finding(candidate: Candidate) -> Finding | None:
        value, delay = gain(candidate), candidate.calibration[channel.name]["delay"]
        if not 1.0 / LEAST_FACTOR < value < LEAST_FACTOR:
            of = "what acts" if channel.quantity in (FORCE, GROUND) else "what the structure does"
            return factor_finding(channel.name, channel.setting, value, of, TOLD_WITHIN * abs(value))
        return None if abs(delay) < LEAST_DELAY_CAUSE * record.step else late_finding(channel, delay, record.step)

    return Cause(record, finding, gain, channel)


def _other(record: Record, structure: Structure, given: Parameter) -> Cause:
    """A mass or a spring is another one."""
    kind, index = _place(structure, given)

    def factor(candidate: Candidate) -> float:
        return float(candidate.parameters[kind][index]) / given.prescribed

    def finding(candidate: Candidate) -> Finding | None:
        times = factor(candidate)
        if 1.0 / LEAST_FACTOR < times < LEAST_FACTOR:
            return None
        value = f"{given.name} = {times * given.prescribed:.4g} {given.unit}"
        reason = f"with {value}, {times:.3g} times what is prescribed, the structure does what was measured"
        of = "mass" if kind == MASS else "stiffness"
        return Finding(of, given.name, f"{reason}; check {structure.labels.setting(given)}")

    return Cause(record, finding, factor, free=(kind, [index]))


def _damping(record: Record, structure: Structure, dampers: Sequence[int]) -> Cause:
    """The dampers are others."""
    given = linear_parts(structure, ())["c"][dampers]
    reason = "with other dampers than the prescribed ones the structure does what was measured"
    finding = Finding("damping", "c", f"{reason}: the model of damping is wrong; let c be unknown (scheme.unknown)")

    def factor(candidate: Candidate) -> float:
        times = candidate.parameters["c"][dampers][given > 0] / given[given > 0]
        return float(np.exp(np.mean(np.log(times)))) if times.size else 1.0

    return Cause(record, _always(finding), factor, free=("c", dampers))
