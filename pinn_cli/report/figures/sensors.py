"""Sensor by sensor: what the estimate leaves, other data, frequency responses; and the losses of the training."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from pinn_cli.record.channel import Channel
from pinn_cli.record.channels import channels, every_channel
from pinn_cli.record.cross_spectra import CrossSpectra
from pinn_cli.record.record import Record
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.record.spectrum import periodogram
from pinn_cli.report.estimates import Histories
from pinn_cli.report.figures import histories, style
from pinn_cli.report.fitness import autocorrelation, nmse_percent
from pinn_cli.report.free_run import ValidationRun
from pinn_cli.system.modes import modes_of
from pinn_cli.system.priors import HALF_WIDTH_95
from pinn_cli.system.quantities import FORCE, GROUND
from pinn_cli.system.structure import Structure
from pinn_cli.training.estimate import Estimate

ROWS_IN_FULL = 8  # more sensors than these: those with the largest NMSE
LAGS_SHOWN = 40
BINS = 300  # of a spectrum: more frequencies than these are averaged
DECADES = 9  # that a spectrum shows at most, if that is enough to see the residual
# Sensors whose frequency response is shown, and lines of the spectrum that are averaged to one measured value.
MOST, AVERAGED = 6, 3
MARKED_ITERATIONS, LINES = 60, ("-", "--", "-.", ":")  # iterations up to which each is marked; of a term of the loss
WITH_NOISE, WITHOUT_NOISE = "95 % with noise", "95 %, noise unknown"
ROUND_OFF = 1e-9  # of the largest value of a sensor: what is left of one that the estimate was given
# What the terms of a loss are called.
TERM_LABELS = {
    "physics": "equation of motion", "ridge": "regularisation", "unforced": "DOFs without a force",
    "forced": "DOFs with a force",
}  # fmt: skip

_RESIDUAL: style.Look = {"color": style.BLUE, "linewidth": 0.6, "zorder": 2}
_SIGNAL: style.Look = {"color": style.GREY, "alpha": 0.55, "linewidth": 0.6, "zorder": 1, "label": "sensor"}
_NOISE: style.Look = {"color": style.VERMILLION, "linewidth": 0.9, "linestyle": "--", "zorder": 3}


@style.look()
def residuals_figure(estimate: Estimate, record: Record) -> Figure:
    """A row for each sensor, measured less estimated: over time, over frequency (Hann periodogram), and over the lag.

    The noise found is drawn as a dashed line: 1.96 standard deviations to either side of the history, its level in the
    spectrum, behind which the sensor's own lies. The autocorrelation of white noise stays in the shaded band 95 % of
    the time. Of more than `ROWS_IN_FULL` sensors those with the largest NMSE are shown, the ground's only where its
    motion was estimated. There is one, see `compared_channels`.
    """
    sensors = compared_channels(estimate, record)
    errors = [nmse_percent(c.measured - c.of(estimate.response), c.measured) for c in sensors]
    shown = [sensors[i] for i in style.largest(errors, ROWS_IN_FULL)]
    labels = "measured less estimated", r"noise found ($\pm$1.96 $\sigma$; level)"
    figure, panels = style.panels(
        len(shown), 3, 1.05, margins=(0.62, 0.08, 0.56, 0.42), gaps=(0.5, 0.26), width_ratios=(1.3, 1.0, 0.8)
    )
    for (history, spectrum, correlation), channel in zip(panels, shown, strict=True):
        signal, sigma = channel.measured, estimate.noise.of(channel)
        residual = signal - channel.of(estimate.response)
        largest = float(np.max(np.abs(residual)))
        reach = max(largest, 1.2 * HALF_WIDTH_95 * sigma) if sigma <= 10.0 * largest else largest
        factor, prefix = style.unit_prefix(reach, kilo=channel.quantity == FORCE)
        edge = np.full(len(residual), factor * HALF_WIDTH_95 * sigma)
        _draw_residual(history, record.time, factor * residual, edge, labels)
        history.set_ylim(-1.1 * factor * (reach or 1.0), 1.1 * factor * (reach or 1.0))
        history.set_title(f"({style.unit(channel.quantity, prefix)})", loc="left", fontsize=7, pad=2)
        _draw_spectrum(spectrum, residual, signal, sigma, record.step)
        spectrum.set_title(f"({style.unit(channel.quantity)})\N{SUPERSCRIPT TWO}", loc="left", fontsize=7, pad=2)
        _draw_correlation(correlation, residual)
        _name(history, channel, record)
        _write_nmse(correlation, residual, signal, digits=2)
    _finish(figure, panels, ("Residual", "Periodogram", "Autocorrelation"), len(sensors))
    for axes, label in zip(panels[-1], ("Time $t$ (s)", "Frequency (Hz)", "Lag (samples)"), strict=True):
        axes.set_xlabel(label, labelpad=2)
    return figure


def compared_channels(estimate: Estimate, record: Record) -> list[Channel]:
    """The sensors that an estimate is compared with: not those that it has nothing of, or was given as exact."""
    out = []
    for channel in every_channel(record):
        residual = channel.measured - channel.of(estimate.response)
        if np.isfinite(residual).all() and np.abs(residual).max() > ROUND_OFF * np.abs(channel.measured).max():
            out.append(channel)
    return out


@style.look()
def validation_figure(run: ValidationRun) -> Figure:
    """A row for each response sensor: its history beside the run's with its 95 % band, and what is between them.

    The band of the error holds the sensor's noise as well, of a sensor that the estimator has seen. Of a record with
    too many periods the histories show the last ones, where errors of the parameters have added up; the error is shown
    as a whole. Of more than `ROWS_IN_FULL` sensors those with the largest NMSE are shown. The run has a response.
    """
    sensors = channels(run.record, RESPONSE_QUANTITIES)
    errors = [nmse_percent(m - s, m) for m, s, _ in map(run.compared, sensors)]
    shown = [sensors[i] for i in style.largest(errors, ROWS_IN_FULL)]
    simulated = np.stack([run.of_channel(channel)[1] for channel in shown], axis=1)
    window = histories.window_about(len(simulated), np.diff(simulated, axis=0, prepend=0.0))
    time = run.record.time[run.first :]
    looks = histories.looks(true="measured", estimate="identified system")
    figure, panels = style.panels(
        len(shown), 2, 0.95, margins=(0.62, 0.08, 0.56, 0.42), gaps=(0.5, 0.28), width_ratios=(1.25, 1.0)
    )
    for (history, error), channel in zip(panels, shown, strict=True):
        measured, response, std = (x[:, None] for x in run.of_channel(channel))
        name, sources = channel.quantity, {"estimate": response, "std": std, "true": measured}
        compared = Histories(name, "", (channel.where,), time, sources)
        factor, prefix = style.unit_prefix(float(np.nanmax(np.abs(measured[window]), initial=0.0)))
        histories.draw(history, compared, 0, window, factor, looks)
        history.set_title(f"({style.unit(name, prefix)})", loc="left", fontsize=7, pad=2)
        residual, sampled = (measured - response)[:, 0], np.isfinite(measured[:, 0])
        noise = run.noise.of(channel)
        edge = HALF_WIDTH_95 * np.hypot(std[:, 0], np.nan_to_num(noise))
        labels = "error", WITH_NOISE if np.isfinite(noise) else WITHOUT_NOISE
        factor, prefix = style.unit_prefix(float(np.nanmax(np.abs(residual), initial=0.0)))
        _draw_residual(error, time[sampled], factor * residual[sampled], factor * edge[sampled], labels)
        error.set_title(f"({style.unit(name, prefix)})", loc="left", fontsize=7, pad=2)
        _name(history, channel, run.record)
        _write_nmse(error, residual[sampled], measured[sampled, 0], digits=3)
    _finish(figure, panels, ("Validation data", "Error"), len(sensors))
    for axes in panels[-1]:
        axes.set_xlabel("Time $t$ (s)", labelpad=2)
    return figure


def _draw_residual(
    axes: Axes, time: np.ndarray, residual: np.ndarray, edge: np.ndarray, labels: tuple[str, str]
) -> None:
    """What is left of a sensor (N,), between the edges of its band, which may be NaN."""
    kept = style.line_indices(residual)
    axes.plot(time[kept], residual[kept], **_RESIDUAL, label=labels[0])
    if np.isfinite(edge).any():
        look = _NOISE | ({"linestyle": ":"} if labels[1] == WITHOUT_NOISE else {})
        axes.plot(time[kept], edge[kept], **look, label=labels[1])
        axes.plot(time[kept], -edge[kept], **look)
    axes.set_xlim(time[0], time[-1])
    style.ticks(axes)


def _draw_spectrum(axes: Axes, residual: np.ndarray, signal: np.ndarray, sigma: float, step: float) -> None:
    """Mean squares: white noise of variance s^2 reads s^2 at every frequency."""
    tops = []
    for values, look in ((signal, _SIGNAL), (residual, _RESIDUAL)):
        # Without the mean; more than `BINS` frequencies are averaged in bins that grow with the frequency.
        frequency, power = (x[1:] for x in periodogram(values, step))
        edges = np.unique(np.geomspace(1, len(power) + 1, BINS).round().astype(int)) - 1
        frequency, power = (np.add.reduceat(x, edges[:-1]) / np.diff(edges) for x in (frequency, power))
        axes.plot(frequency, np.where(power > 0.0, power, np.nan), **look)
        tops += [float(power.max())]
    if sigma > 0.0:
        axes.axhline(sigma**2, **_NOISE)
    axes.set_xscale("log")
    axes.set_xlim(frequency[0], frequency[-1])
    if not max(tops) > 0.0:  # nothing has a place on a logarithmic scale
        axes.set_yticks([])
        return
    axes.set_yscale("log")
    bottom, top = axes.get_ylim()
    seen = 1e-2 * tops[1] if tops[1] > 0.0 else top
    axes.set_ylim(max(bottom, min(top * 10.0**-DECADES, seen)), top)
    axes.yaxis.set_major_locator(LogLocator(numticks=5))
    axes.yaxis.set_minor_locator(NullLocator())


def _draw_correlation(axes: Axes, residual: np.ndarray) -> None:
    lags, bound = min(LAGS_SHOWN, len(residual) - 1), HALF_WIDTH_95 / np.sqrt(len(residual))
    correlation = autocorrelation(residual, lags)
    axes.axhspan(-bound, bound, color=style.ORANGE, alpha=0.3, linewidth=0, zorder=0, label="white noise, 95 %")
    axes.axhline(0.0, color=style.GREY, linewidth=0.5)
    axes.vlines(np.arange(1, lags + 1), 0.0, correlation, color=style.BLUE, linewidth=1.0)
    axes.set_xlim(0, lags + 1)
    reach = max(3.0 * bound, 1.15 * float(np.nanmax(np.abs(correlation), initial=0.0)))
    axes.set_ylim(-reach, reach)
    axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10]))


def _name(axes: Axes, channel: Channel, record: Record) -> None:
    """Quantity and place of a sensor before its row."""
    place = channel.where if record.dofs or not channel.is_column else f"DOF {channel.where}"
    place = "ground" if channel.quantity == GROUND and channel.is_column else place
    axes.set_ylabel(f"{style.SYMBOLS[channel.quantity]}, {style.literal(place)}")


def _write_nmse(axes: Axes, residual: np.ndarray, signal: np.ndarray, digits: int) -> None:
    error = nmse_percent(residual, signal)
    if np.isfinite(error):
        axes.set_title(f"NMSE {error:.{digits}g} %", loc="right", fontsize=7, pad=2)


def _finish(figure: Figure, panels: np.ndarray, titles: tuple[str, ...], count: int) -> None:
    """Titles of the columns, the legend, and how many of all sensors are shown."""
    for axes, title in zip(panels[0], titles, strict=True):
        style.head(axes, title)
    figure.align_ylabels(list(panels[:, 0]))
    style.legend(figure)
    if count > len(panels):
        style.note(figure, f"the {len(panels)} of {count} sensors with the largest NMSE")


@style.look()
def frequency_response_figure(record: Record, structure: Structure) -> Figure:
    """Amplitude and phase of every sensor over the measured force, within the band of a record, and as estimated."""
    assert record.band is not None
    sensors, load = channels(record)[:MOST], channels(record, (FORCE,))
    first, stop = np.searchsorted(np.fft.rfftfreq(len(record.time), record.step), record.band.edges)
    spectra = CrossSpectra.of_bands(record, sensors, load, range(first, stop + 1, AVERAGED))
    modes = modes_of(structure)
    at = modes.shapes[[sensor.dof for sensor in sensors]] * modes.pushed[:, load[0].dof]
    estimated = (1.0 / (1j * spectra.omega[:, None] - modes.poles)) @ at.T * spectra.differentiation
    shown = (
        (spectra.response[..., 0], style.DOTS | {"color": style.GREY, "label": "measured"}),
        (estimated, {"color": style.BLUE, "label": "estimated"}),
    )
    figure, panels = style.panels(2, len(sensors), 1.5, margins=(0.55, 0.08, 0.45, 0.4), gaps=(0.5, 0.12), sharex="col")
    for i, ((above, below), sensor) in enumerate(zip(panels.T, sensors, strict=True)):
        for values, look in shown:
            above.semilogy(spectra.frequency, np.abs(values[:, i]), **look)
            below.plot(spectra.frequency, np.degrees(np.angle(values[:, i])), **look)
        title = f"{style.SYMBOLS[sensor.quantity]} of {record.dof_names([sensor.dof])}"
        above.set_title(f"{title}, {style.unit(sensor.quantity)}/N", pad=3)
        below.set_yticks([-180, -90, 0, 90, 180])
        below.set_xlabel("Frequency (Hz)", labelpad=2)
    panels[0, 0].set_ylabel("Amplitude")
    panels[1, 0].set_ylabel("Phase (°)")
    style.legend(figure)
    return figure


@style.look()
def history_figure(history: pd.DataFrame) -> Figure:
    """Columns ``loss_*`` in the upper panel, ``weight_*`` in the lower one, over ``iteration``, on logarithmic scales.

    A panel whose columns are missing is left out; values that are not positive have no place on the scale and are left
    out. A term keeps its colour and its dashes in both panels, so that one legend is that of both.
    """
    titles = {"loss_": "Loss term", "weight_": r"Loss weight $\lambda$"}
    columns = {start: [str(name) for name in history if str(name).startswith(start)] for start in titles}
    shown = [start for start in titles if columns[start]]
    terms = list(dict.fromkeys(name.removeprefix(start) for start in shown for name in columns[start]))
    iterations, margins = history["iteration"].to_numpy(), (0.08 * style.PAGE_WIDTH, 0.3 * style.PAGE_WIDTH, 0.1, 0.38)
    figure, panels = style.panels(len(shown), 1, 1.68, margins=margins, gaps=(0.0, 0.17), sharex=True)
    for axes, start in zip(panels[:, 0], shown, strict=True):
        for name in columns[start]:
            values, term = history[name].to_numpy(dtype=float), name.removeprefix(start)
            kept = np.flatnonzero(np.isfinite(values) & (values > 0.0))
            if not kept.size:
                continue
            kept = kept[style.line_indices(np.log(values[kept]))]
            place, marker = terms.index(term), "o" if len(iterations) <= MARKED_ITERATIONS else "none"
            look: style.Look = {"color": style.CYCLE[place % len(style.CYCLE)], "linestyle": LINES[place % len(LINES)]}
            label = TERM_LABELS.get(term, term.replace("_", " "))
            axes.plot(iterations[kept], values[kept], **look, marker=marker, markersize=2.2, label=label)
        axes.set_yscale("log")
        axes.set_ylabel(titles[start])
        axes.yaxis.set_minor_locator(NullLocator())
        axes.grid(True, axis="y")
        axes.set_axisbelow(True)
    axes.set_xlabel("Iteration")
    axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    figure.align_ylabels(list(panels[:, 0]))
    style.legend(figure, loc="upper left", bbox_to_anchor=(0.71, 0.98), ncols=1, borderaxespad=0.0, handlelength=2.8)
    return figure
