"""Connections: their drifts, loops of those with memory, laws that were sought, and the force that one leaves out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pinn_cli.record.spectrum import periodogram
from pinn_cli.report.estimates import Histories, RestoringCurve
from pinn_cli.report.figures import histories, style
from pinn_cli.report.results import Results
from pinn_cli.system.connection.nonlinearity import OVER
from pinn_cli.system.modes import NaturalModes
from pinn_cli.system.priors import HALF_WIDTH_95
from pinn_cli.training.estimate import estimated_structure

ROWS_IN_FULL, LOOPS_IN_FULL = 8, 6  # more connections than these: those with the largest drifts, or forces
SAMPLES_SHOWN = 600  # of a loop, about the largest elongation
# Least of a force that is left out, over the force that acts, rms, that is drawn.
NOTICEABLE = 0.01
# Share of the power of the elongation's rate below a frequency; so many times as high a force is drawn that follows it.
MOVING, HARMONICS = 0.95, 4.0
CLASSES = 24  # of equal size, whose means tell whether the force follows something
MOST_DOTS = 4000  # of a longer record, evenly chosen

# Of the axis of peaks, how much more there is of it than the largest.
PEAK_ROOM = 1.06
_PEAK_MARK: style.Look = {"color": style.VERMILLION, "linestyle": "none", "marker": "o", "markersize": 3.5}
_TRUE_PEAK: style.Look = {
    "color": style.BLACK, "linestyle": "none", "marker": "D", "markersize": 5.0, "markerfacecolor": "none",
    "markeredgewidth": 0.8,
}  # fmt: skip


@style.look()
def drift_figure(drifts: Histories, truth_label: str = "truth", shown_s: tuple[float, float] | None = None) -> Figure:
    """A row for each connection, its drift over time with its 95 % band; on the right the peaks with 90 % intervals.

    Of more than `ROWS_IN_FULL` connections the histories of those with the largest peaks are shown; the peaks of all.
    Of a record with too many periods, the histories about the largest of all peaks. ``truth_label`` is what the legend
    calls the truth, which is drawn where it is known. Histories are shown between two times, if they are given.
    """
    estimate, (peaks, sample) = drifts.of("estimate"), drifts.peaks()
    shown = style.largest(peaks, ROWS_IN_FULL)
    window = histories.window_about(int(sample[np.argmax(peaks)]), np.diff(estimate, axis=0, prepend=0.0))
    if shown_s is not None:
        window = histories.window_between(drifts.time, shown_s)
    figure, panels = style.panels(
        len(shown), 2, 0.75, margins=(0.75, 0.08, 0.5, 0.42), gaps=(0.75, 0.12), width_ratios=(2.4, 1.0)
    )
    factor = histories.draw_column(panels[:, 0], drifts, shown, window, histories.looks(true=truth_label))
    for axes, place in zip(panels[:, 0], shown, strict=True):
        if window.start <= sample[place] < window.stop:
            axes.plot(drifts.time[sample[place]], factor * estimate[sample[place], place], **_PEAK_MARK)
        name = drifts.places[place]
        axes.set_ylabel(f"connection {name}" if name.isdecimal() else name)  # a number alone would not say of what
    figure.align_ylabels(list(panels[:, 0]))
    top, bottom = panels[0, 1].get_position(), panels[-1, 1].get_position()
    for axes in panels[:, 1]:
        axes.remove()
    peak_axes = figure.add_axes((bottom.x0, bottom.y0, top.width, top.y1 - bottom.y0))
    _draw_peaks(peak_axes, drifts, factor)
    peak_axes.set_xlabel(panels[0, 0].get_title().replace("Drift", "Peak drift"), labelpad=2)
    style.legend(figure)
    if len(shown) < len(peaks):
        style.note(figure, f"histories: the {len(shown)} of {len(peaks)} connections with the largest peaks")
    return figure


def _draw_peaks(axes: Axes, drifts: Histories, factor: float) -> None:
    """The first connection lowest, as the storeys of a building are."""
    peaks = drifts.peak_estimates()
    place = np.arange(len(peaks.estimate))
    has_std = np.isfinite(peaks.std).all()
    dot = {**_PEAK_MARK, "markersize": 2.0} if has_std else _PEAK_MARK
    axes.plot(factor * peaks.estimate, place, **dot, label="peak, 90 % interval" if has_std else "peak")
    if has_std:
        ends = factor * np.maximum(peaks.interval, 0.0)
        axes.hlines(place, *ends, color=style.VERMILLION, linewidth=1.2)
        for end in ends:  # upright bars, higher than the dot, which hides a short interval
            axes.plot(end, place, "|", color=style.VERMILLION, markersize=12.0, markeredgewidth=0.9)
    axes.plot(factor * peaks.true, place, **_TRUE_PEAK)
    axes.set_xlim(0.0, PEAK_ROOM * axes.dataLim.x1)
    axes.set_ylim(-0.6, len(place) - 0.4)
    few = place if len(place) <= 2 * ROWS_IN_FULL else place[:: -(-len(place) // ROWS_IN_FULL)]
    axes.set_yticks(few, [drifts.places[i] for i in few])
    axes.xaxis.set_major_locator(MaxNLocator(4))


@style.look()
def hysteresis_figure(drifts: Histories, forces: Histories, memory: np.ndarray, truth_label: str = "truth") -> Figure:
    """A panel for each connection with memory: its force over its elongation, the 95 % band of the force, the truth.

    ``memory`` are the positions of these among the connections that are stretched by their drifts, at least one.
    """
    elongation, estimate = drifts.of("estimate"), forces.of("estimate")
    shown = memory[style.largest(np.abs(estimate[:, memory]).max(axis=0), LOOPS_IN_FULL)]
    factor, prefix = style.unit_prefix(float(np.abs(elongation[:, shown]).max()))
    of_force, force_prefix = style.unit_prefix(float(np.abs(estimate[:, shown]).max()))
    looks = histories.looks(true=truth_label)
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    figure, panels = style.panels(rows, columns, 2.1, margins=(0.62, 0.1, 0.42, 0.42), gaps=(0.62, 0.45))
    for axes, place in zip(panels.flat, shown.tolist(), strict=False):
        middle = int(np.argmax(np.abs(elongation[:, place])))
        first = max(0, min(middle - SAMPLES_SHOWN // 2, len(elongation) - SAMPLES_SHOWN))
        window = slice(first, first + SAMPLES_SHOWN)
        for source in ("true", "estimate"):
            e, r = factor * drifts.of(source)[window, place], of_force * forces.of(source)[window, place]
            if np.isfinite(r).any():
                axes.plot(e, r, **looks[source])
        # A band about a loop: its edges are loops too, drawn as bars at the samples.
        low, high = (of_force * edge for edge in histories.band(forces, place, window))
        axes.vlines(e, low, high, **{**looks["band"], "linewidth": 1.2})
        axes.set_title(forces.places[place], pad=3)
    for axes in panels.flat[len(shown) :]:
        axes.set_visible(False)
    for axes in panels[:, 0]:
        axes.set_ylabel(f"Force ({style.unit('force', force_prefix)})", labelpad=2)
    for axes in panels[-1]:
        axes.set_xlabel(f"Elongation ({style.unit('displacement', prefix)})", labelpad=2)
    style.legend(figure)
    return figure


@style.look()
def restoring_figure(curves: Sequence[RestoringCurve], truth_label: str = "truth") -> Figure:
    """A row for each connection whose law was sought: its force over its elongation and over its speed, 95 % bands.

    Where nine tenths of the samples lie is shaded: outside, few samples tell anything. Of more than `LOOPS_IN_FULL`
    connections, those with the largest forces.
    """
    rows = [list(curves[i : i + len(OVER)]) for i in range(0, len(curves), len(OVER))]
    largest = np.array([max(float(np.abs(curve.force.estimate).max()) for curve in row) for row in rows])
    shown = style.largest(largest, LOOPS_IN_FULL)
    of_force, prefix = style.unit_prefix(float(largest[shown].max()), kilo=True)
    has_truth = bool(np.isfinite(curves[0].force.true).all())
    looks = histories.with_truth(histories.looks(true=truth_label), has_truth)
    figure, panels = style.panels(len(shown), 2, 1.5, margins=(0.62, 0.1, 0.42, 0.42), gaps=(0.62, 0.45))
    for row, place in zip(panels, shown, strict=True):
        for axes, curve in zip(row, rows[place], strict=True):
            factor, at_prefix = style.unit_prefix(float(np.abs(curve.at).max()))
            at, force = factor * curve.at, curve.force
            spread = HALF_WIDTH_95 * force.std
            axes.axvspan(*(factor * x for x in curve.usual), color=style.GREY, alpha=0.12, linewidth=0)
            if has_truth:
                axes.plot(at, of_force * force.true, **looks["true"])
            axes.plot(at, of_force * force.estimate, **looks["estimate"])
            limits = axes.get_ylim()
            axes.fill_between(at, *(of_force * (force.estimate + side * spread) for side in (-1, 1)), **looks["band"])
            axes.set_ylim(limits)
            quantity = dict(zip(OVER, ("displacement", "velocity"), strict=True))[curve.over]
            axes.set_xlabel(f"{curve.over.capitalize()} ({style.unit(quantity, at_prefix)})", labelpad=2)
        row[0].set_title(curve.connection, pad=3)
        row[0].set_ylabel(f"Force ({style.unit('force', prefix)})", labelpad=2)
    style.legend(figure)
    style.note(figure, "grey: nine tenths of the samples")
    return figure


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """What one connection would have to pull with, beside its law, for the estimated motion to be the structure's.

    Attributes:
        connection: Its name, or its number from 1.
        time: (L,), s.
        force: (L,), N: the posterior mean.
        slow: (L,), N, the same without what is far above the frequencies of its motion.
        elongation, velocity: (L,), m and m/s.
        natural: Natural frequencies of the estimated structure, Hz.
        missing: Those of modes that are found not to be in the model, Hz.
    """

    connection: str
    time: np.ndarray
    force: np.ndarray
    slow: np.ndarray
    elongation: np.ndarray
    velocity: np.ndarray
    natural: np.ndarray
    missing: tuple[float, ...]

    @classmethod
    def of(cls, results: Results) -> Discrepancy | None:
        """That of the connection that is most doubtful; None where nothing noticeable is left out, or no one pulls."""
        estimate, structure = results.estimate, results.prescribed
        misfit, connections = estimate.misfit, estimate.connections
        if misfit is None or connections is None or structure.is_modal or not len(structure.added):
            return None
        pulls = structure.incidence.matrix[structure.added].toarray()
        forces = -misfit.history.astype(np.float64) @ np.linalg.pinv(pulls, rcond=1e-9)
        count, doubts = len(forces), estimate.doubts
        elongation = connections.elongation[-count:, : len(structure.added)]
        velocity = np.gradient(elongation, misfit.step, axis=0)
        slow = np.column_stack([_slow(f, v, misfit.step) for f, v in zip(forces.T, velocity.T, strict=True)])
        names = [structure.labels.connection(int(i)) for i in structure.added]
        doubted = [names.index(d.of.removeprefix("connection ")) for d in doubts if d.of.startswith("connection ")]
        if not doubted and not np.sqrt(np.mean(slow**2)) > NOTICEABLE * misfit.acting > 0.0:
            return None
        at = doubted[0] if doubted else int(np.argmax(np.mean(slow**2, axis=0)))
        modes = NaturalModes.of(estimated_structure(structure, estimate.parameters))
        natural = np.zeros(0) if modes is None else modes.frequencies
        missing = tuple(doubt.shape for doubt in doubts if doubt.kind == "mode")
        force, slow, e, de = (x[:, at] for x in (forces, slow, elongation, velocity))
        return cls(names[at], results.record.time[-count:], force, slow, e, de, natural, missing)

    def explained_by(self, history: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Means of a history (L,) and of the force in classes of it, and the share of the force that they explain."""
        parts = np.array_split(np.argsort(history, kind="stable"), CLASSES)
        x, y = (np.array([values[part].mean() for part in parts]) for values in (history, self.slow))
        residual = sum(float(np.sum((self.slow[part] - mean) ** 2)) for part, mean in zip(parts, y, strict=True))
        total = float(np.sum((self.slow - self.slow.mean()) ** 2))
        return x, y, max(0.0, 1.0 - residual / total) if total > 0.0 else 0.0


def _slow(force: np.ndarray, velocity: np.ndarray, step: float) -> np.ndarray:
    """A force (L,) up to some times the frequency below which nearly all of the velocity is."""
    frequency, power = periodogram(velocity, step)
    share = np.cumsum(power) / max(float(power.sum()), 1e-300)
    edge = HARMONICS * float(frequency[min(int(np.searchsorted(share, MOVING)), len(frequency) - 1)])
    lines = np.fft.rfft(force)
    lines[np.fft.rfftfreq(len(force), step) > edge] = 0.0
    return np.fft.irfft(lines, len(force))


@style.look()
def discrepancy_figure(discrepancy: Discrepancy) -> Figure:
    """Four panels: dots and class means of the force over elongation and over velocity, its history, its spectrum.

    Friction is a step over the velocity, play a step over the elongation, a stiffer spring a bend. Above the first two
    stands the share of the force that a function of that alone explains.
    """
    of_force, force_prefix = style.unit_prefix(float(np.abs(discrepancy.slow).max()), kilo=True)
    figure, panels = style.panels(2, 2, 1.9, margins=(0.62, 0.12, 0.5, 0.42), gaps=(0.62, 0.6))
    (over_elongation, over_velocity), (over_time, spectrum) = panels
    kept, named = style.line_indices(discrepancy.slow), f"force left out, connection {discrepancy.connection}"
    over_time.plot(
        discrepancy.time[kept], of_force * discrepancy.slow[kept], color=style.BLUE, linewidth=0.6, label=named
    )
    over_time.set_xlabel("Time $t$ (s)", labelpad=2)
    over_time.set_xlim(discrepancy.time[0], discrepancy.time[-1])
    for axes, history, quantity, name in (
        (over_elongation, discrepancy.elongation, "displacement", "Elongation"),
        (over_velocity, discrepancy.velocity, "velocity", "Velocity"),
    ):
        factor, prefix = style.unit_prefix(float(np.abs(history).max()))
        stride = max(1, len(history) // MOST_DOTS)
        x, y, share = discrepancy.explained_by(history)
        dots = style.DOTS | {"markersize": 2.0, "color": style.SKY}
        axes.plot(factor * history[::stride], of_force * discrepancy.slow[::stride], **dots)
        axes.plot(factor * x, of_force * y, color=style.VERMILLION, linewidth=1.2, label="mean")
        axes.axhline(0.0, color=style.GREY, linewidth=0.5, zorder=0)
        axes.set_title(f"explains {100.0 * share:.0f} %", loc="right", fontsize=7, pad=2)
        axes.set_xlabel(f"{name} ({style.unit(quantity, prefix)})", labelpad=2)
    _draw_spectrum(spectrum, discrepancy)
    for axes in panels[:, 0]:
        axes.set_ylabel(f"Force left out ({style.unit('force', force_prefix)})", labelpad=2)
    style.legend(figure, [over_time, *panels.flat])
    return figure


def _draw_spectrum(axes: Axes, discrepancy: Discrepancy) -> None:
    """Mean squares at every frequency, of all of the force and of what the other panels show."""
    step = float(discrepancy.time[1] - discrepancy.time[0])
    frequency, power = (x[1:] for x in periodogram(discrepancy.force, step))
    _, slow = (x[1:] for x in periodogram(discrepancy.slow, step))
    axes.plot(frequency, power, color=style.GREY, alpha=0.6, linewidth=0.6, label="the same above its motion")
    axes.plot(frequency, np.where(slow > 1e-9 * slow.max(initial=0.0), slow, np.nan), color=style.BLUE, linewidth=0.6)
    dashes: style.Look = {"color": style.BLACK, "linewidth": 0.8, "linestyle": (0, (2.5, 1.2))}
    for at in discrepancy.natural[(discrepancy.natural >= frequency[0]) & (discrepancy.natural <= frequency[-1])]:
        axes.axvline(at, label="natural frequency", **dashes)
    for at in discrepancy.missing:
        axes.axvline(at, color=style.VERMILLION, linewidth=1.0, linestyle=(0, (1, 1.2)), label="mode not in the model")
    axes.set_xscale("log")
    axes.set_xlim(frequency[0], frequency[-1])
    axes.set_xlabel("Frequency (Hz)", labelpad=2)
    if power.max(initial=0.0) > 0.0:
        axes.set_yscale("log")
    axes.set_ylabel("Mean square (N\N{SUPERSCRIPT TWO})", labelpad=2)
