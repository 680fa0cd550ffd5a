"""What the estimate leaves of every sensor: its history, its spectrum, and its autocorrelation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from pinn_cli.record.channels import Channel, every_channel
from pinn_cli.record.response import GROUND
from pinn_cli.record.spectrum import periodogram
from pinn_cli.report.figures import style
from pinn_cli.report.figures.decimate import line_indices
from pinn_cli.report.residuals import autocorrelation, nmse_percent
from pinn_cli.verdict.noise_findings import noise_found

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pinn_cli.record.record import Record
    from pinn_cli.training.estimate import Estimate

ROWS_IN_FULL = 8  # more sensors than these: those with the largest NMSE
LAGS_SHOWN = 40
BAND = 1.96  # standard deviations: white noise stays within them 95 % of the time
BINS = 300  # of a spectrum: more frequencies than these are averaged
DECADES = 9  # that a spectrum shows at most, if that is enough to see the residual

_RESIDUAL: dict[str, Any] = {"color": style.BLUE, "linewidth": 0.6, "zorder": 2}
_SIGNAL: dict[str, Any] = {"color": style.GREY, "alpha": 0.55, "linewidth": 0.6, "zorder": 1}
_NOISE: dict[str, Any] = {"color": style.VERMILLION, "linewidth": 0.9, "linestyle": "--", "zorder": 3}
_WHITE: dict[str, Any] = {"color": style.ORANGE, "alpha": 0.3, "linewidth": 0, "zorder": 0}


def residuals_figure(estimate: Estimate, record: Record) -> Figure:
    """A row for each sensor, measured less estimated: over time, over frequency (Hann periodogram), and over the lag.

    The noise found is drawn as a dashed line: 1.96 standard deviations to either side of the history, its level in the
    spectrum, behind which the sensor's own lies. The autocorrelation of white noise stays in the shaded band 95 % of
    the time. Of more than `ROWS_IN_FULL` sensors those with the largest NMSE are shown.

    Args:
        estimate: Its response, and in its summary the noise found.
        record: The sensors, at least one. The ground's is left out where its motion was not estimated.
    """
    every = [c for c in every_channel(record) if np.isfinite(c.of(estimate.response)).all()]
    shown = _worst(estimate, every)
    with style.look():
        figure, panels = style.panels(
            len(shown), 3, 1.05, margins=(0.62, 0.08, 0.56, 0.42), gaps=(0.5, 0.26), width_ratios=(1.3, 1.0, 0.8)
        )
        for row, channel in zip(panels, shown, strict=True):
            _draw_row(row, estimate, record, channel)
        for axes, label in zip(panels[-1], ("Time $t$ (s)", "Frequency (Hz)", "Lag (samples)"), strict=True):
            axes.set_xlabel(label, labelpad=2)
        for axes, title in zip(panels[0], ("Residual", "Periodogram", "Autocorrelation"), strict=True):
            axes.annotate(title, (0.5, 1.0), xycoords="axes fraction", xytext=(0, 14), textcoords="offset points",
                          ha="center", fontsize=8.5)  # fmt: skip
        figure.align_ylabels(list(panels[:, 0]))
        _legend(figure, estimate, shown, len(every))
    return figure


def _worst(estimate: Estimate, every: list[Channel]) -> list[Channel]:
    """At most `ROWS_IN_FULL` sensors, in their order."""
    if len(every) <= ROWS_IN_FULL:
        return every
    errors = [nmse_percent(c.measured - c.of(estimate.response), c.measured) for c in every]
    kept = np.argsort(-np.nan_to_num(errors), kind="stable")[:ROWS_IN_FULL]
    return [every[i] for i in sorted(kept)]


def _draw_row(panels: np.ndarray, estimate: Estimate, record: Record, channel: Channel) -> None:
    signal, left = channel.measured, channel.measured - channel.of(estimate.response)
    sigma = noise_found(estimate, channel)
    history, spectrum, correlation = panels
    _draw_history(history, record.time, left, sigma, channel)
    _draw_spectrum(spectrum, left, signal, sigma, record.step)
    spectrum.set_title(f"({style.unit(channel.quantity)})\N{SUPERSCRIPT TWO}", loc="left", fontsize=7, pad=2)
    _draw_correlation(correlation, left)
    named = bool(record.dofs) or channel.gauge is not None
    place = channel.label if named else f"DOF {channel.where}"
    place = "ground" if channel.quantity == GROUND and channel.gauge is None else place
    history.set_ylabel(f"{style.SYMBOLS[channel.quantity]}, {place}")
    error = nmse_percent(left, signal)
    if np.isfinite(error):
        correlation.set_title(f"NMSE {error:.2g} %", loc="right", fontsize=7, pad=2)


def _draw_history(axes: Axes, time: np.ndarray, left: np.ndarray, sigma: float, channel: Channel) -> None:
    largest = float(np.max(np.abs(left)))
    reach = max(largest, 1.2 * BAND * sigma) if sigma <= 10.0 * largest else largest
    factor, prefix = style.unit_prefix(reach, kilo=channel.quantity == "force")
    kept = line_indices(left)
    axes.plot(time[kept], factor * left[kept], **_RESIDUAL)
    for end in (-BAND, BAND):
        axes.axhline(factor * end * sigma, **_NOISE)
    axes.set_xlim(time[0], time[-1])
    axes.set_ylim(-1.1 * factor * (reach or 1.0), 1.1 * factor * (reach or 1.0))
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10], min_n_ticks=3))
    axes.set_title(f"({style.unit(channel.quantity, prefix)})", loc="left", fontsize=7, pad=2)


def _draw_spectrum(axes: Axes, left: np.ndarray, signal: np.ndarray, sigma: float, step: float) -> None:
    """Mean squares: white noise of variance s^2 reads s^2 at every frequency."""
    tops = []
    for values, look in ((signal, _SIGNAL), (left, _RESIDUAL)):
        frequency, power = _binned(*periodogram(values, step))
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


def _binned(frequency: np.ndarray, power: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Without the mean; more than `BINS` frequencies are averaged in bins that grow with the frequency."""
    frequency, power = frequency[1:], power[1:]
    edges = np.unique(np.geomspace(1, len(power) + 1, BINS).round().astype(int)) - 1
    counts = np.diff(edges)
    return np.add.reduceat(frequency, edges[:-1]) / counts, np.add.reduceat(power, edges[:-1]) / counts


def _draw_correlation(axes: Axes, left: np.ndarray) -> None:
    lags, bound = min(LAGS_SHOWN, len(left) - 1), BAND / np.sqrt(len(left))
    correlation = autocorrelation(left, lags)
    axes.axhspan(-bound, bound, **_WHITE)
    axes.axhline(0.0, color=style.GREY, linewidth=0.5)
    axes.vlines(np.arange(1, lags + 1), 0.0, correlation, color=style.BLUE, linewidth=1.0)
    axes.set_xlim(0, lags + 1)
    reach = max(3.0 * bound, 1.15 * float(np.nanmax(np.abs(correlation), initial=0.0)))
    axes.set_ylim(-reach, reach)
    axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10]))


def _legend(figure: Figure, estimate: Estimate, shown: list[Channel], count: int) -> None:
    handles: list[Line2D | Patch] = [
        Line2D([], [], label="measured less estimated", **_RESIDUAL),
        Line2D([], [], label="sensor", **_SIGNAL),
    ]
    if any(np.isfinite(noise_found(estimate, channel)) for channel in shown):
        handles.append(Line2D([], [], label=r"noise found ($\pm$1.96 $\sigma$; level)", **_NOISE))
    handles.append(Patch(label="white noise, 95 %", **_WHITE))
    figure.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 1.0), ncols=len(handles))
    if count > len(shown):
        note = f"the {len(shown)} of {count} sensors with the largest NMSE"
        figure.text(0.01, 0.002, note, ha="left", va="bottom", fontsize=7)
