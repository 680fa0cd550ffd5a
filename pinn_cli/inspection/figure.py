"""A row for each channel, over time and over frequency; below, frequency responses and coherences."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from pinn_cli.report.figures import style
from pinn_cli.report.figures.style import line_indices

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pinn_cli.inspection.inspection import Inspection
    from pinn_cli.record.signal import Signal

ROWS = 8  # more channels than these are left to inspect.csv
FIRST = 300  # lines of a spectrum that are all drawn
DECADES = 10  # that a spectrum shows at most

_LINE: dict[str, Any] = {"color": style.BLUE, "linewidth": 0.6, "zorder": 2}
_FLOOR: dict[str, Any] = {"color": style.VERMILLION, "linewidth": 0.9, "linestyle": "--", "zorder": 3, "label": "noise"}
_BAND: dict[str, Any] = {
    "color": style.SKY, "alpha": 0.15, "linewidth": 0, "zorder": 0, "label": "band: signal above its noise",
}  # fmt: skip
_PEAK: dict[str, Any] = {"color": style.GREY, "linewidth": 0.5, "zorder": 1, "label": "natural frequency found"}
_MODE: dict[str, Any] = {
    "color": style.ORANGE, "linewidth": 0.9, "linestyle": ":", "zorder": 1, "label": "of the structure given",
}  # fmt: skip


def inspection_figure(found: Inspection) -> Figure:
    """Histories and power spectra; shaded, the band; dashed, the noise. Peaks are grey, the structure's dotted."""
    shown = [*found.spectra.acting, *found.spectra.sensors][:ROWS]
    responses = bool(found.spectra.acting) and bool(found.spectra.sensors)
    with style.look():
        figure, panels = style.panels(
            len(shown) + responses, 2, 0.95, margins=(0.66, 0.1, 0.56, 0.5), gaps=(0.6, 0.34), width_ratios=(1.2, 1.0)
        )
        for (left, right), signal in zip(panels, shown, strict=False):
            _draw_history(left, found, signal)
            _draw_spectrum(right, found, signal)
        rows = panels[: len(shown)]
        rows[-1, 0].set_xlabel("Time $t$ (s)", labelpad=2)
        rows[-1, 1].set_xlabel("Frequency (Hz)", labelpad=2)
        if responses:
            _draw_responses(panels[-1, 0], panels[-1, 1], found)
            box = [axes.get_position() for axes in panels[-1]]
            lower = 0.55 * (panels[-2, 0].get_position().y0 - box[0].y1)  # room for the labels of the rows above
            for axes, place in zip(panels[-1], box, strict=True):
                axes.set_position((place.x0, place.y0, place.width, place.height - 0.25 * lower))
        for axes, title in zip(panels[0], ("History", "Power spectral density"), strict=True):
            style.head(axes, title)
        figure.align_ylabels(list(panels[:, 0]))
        style.legend(figure, rows.flat)
    return figure


def _draw_history(axes: Axes, found: Inspection, signal: Signal) -> None:
    kept = line_indices(np.where(np.isfinite(signal.values), signal.values, np.nanmean(signal.values)))
    axes.plot(found.sampling.time[kept], signal.values[kept], **_LINE)
    axes.set_xlim(found.sampling.time[0], found.sampling.time[-1])
    axes.yaxis.set_major_locator(MaxNLocator(4))
    axes.xaxis.set_major_locator(MaxNLocator(6))
    axes.ticklabel_format(axis="y", style="sci", scilimits=(-3, 4))
    axes.set_ylabel(_label(signal))
    if unit := _unit(signal):
        axes.set_title(f"({unit})", loc="left", fontsize=7, pad=2)


def _draw_spectrum(axes: Axes, found: Inspection, signal: Signal) -> None:
    spectra = found.spectra
    i = next(i for i, other in enumerate([*spectra.sensors, *spectra.acting]) if other is signal)
    power = spectra.density[1:, i]
    kept = _spectral_indices(power)
    axes.plot(spectra.frequency[1:][kept], np.where(power > 0.0, power, np.nan)[kept], **_LINE)
    row = found.channels.iloc[next(j for j, other in enumerate(found.signals) if other is signal)]
    if np.isfinite(row["band_high_hz"]):
        axes.axvspan(row["band_low_hz"], row["band_high_hz"], **_BAND)
    if row["noise"] > 0.0:
        axes.axhline(2.0 * row["noise"] ** 2 / found.sampling.rate, **_FLOOR)
    if unit := _unit(signal):
        axes.set_title(f"({unit})\N{SUPERSCRIPT TWO}/Hz", loc="left", fontsize=7, pad=2)
    _draw_peaks(axes, found)
    _logarithmic(axes, float(power.max()), (spectra.frequency[1], spectra.frequency[-1]))


def _draw_responses(magnitude: Axes, coherence: Axes, found: Inspection) -> None:
    spectra = found.spectra
    size = np.sqrt(np.sum(np.abs(spectra.response[1:]) ** 2, axis=2))
    for k, sensor in enumerate(spectra.sensors[:ROWS]):
        look: dict[str, Any] = {"color": style.CYCLE[k % len(style.CYCLE)], "linewidth": 0.7, "label": _label(sensor)}
        for axes, values in ((magnitude, size[:, k]), (coherence, spectra.coherence[1:, k])):
            kept = _spectral_indices(values)
            axes.plot(spectra.frequency[1:][kept], np.where(values > 0.0, values, np.nan)[kept], **look)
    magnitude.legend(loc="best", fontsize=6, ncols=2, handlelength=1.2)  # peaks have their place above
    for axes in (magnitude, coherence):
        _draw_peaks(axes, found)
        axes.set_xlabel("Frequency (Hz)", labelpad=2)
    _logarithmic(magnitude, float(np.nanmax(size)), (spectra.frequency[1], spectra.frequency[-1]))
    magnitude.set_ylabel("response")
    sensed, acting = ({_unit(signal) for signal in signals} for signals in (spectra.sensors[:ROWS], spectra.acting))
    if len(sensed) == len(acting) == 1 and "" not in sensed | acting:  # else each line has a unit of its own
        magnitude.set_title(f"({sensed.pop()}) / {acting.pop()}", loc="left", fontsize=7, pad=2)
    coherence.set_xscale("log")
    coherence.set_xlim(spectra.frequency[1], spectra.frequency[-1])
    coherence.set_ylim(0.0, 1.02)
    coherence.set_ylabel("coherence")


def _spectral_indices(values: np.ndarray) -> np.ndarray:
    """Indices that keep the outline over a logarithmic axis: every line at first, extremes further on."""
    return np.concatenate([np.arange(min(FIRST, len(values))), FIRST + line_indices(values[FIRST:])])


def _draw_peaks(axes: Axes, found: Inspection) -> None:
    for frequency in found.peaks["frequency_hz"]:
        axes.axvline(frequency, **_PEAK)
    for frequency in found.peaks["structure_hz"].dropna().unique():
        axes.axvline(frequency, **_MODE)


def _logarithmic(axes: Axes, top: float, within: tuple[float, float]) -> None:
    axes.set_xscale("log")
    axes.set_xlim(*within)
    if not top > 0.0:
        return
    axes.set_yscale("log")
    axes.set_ylim(max(axes.get_ylim()[0], top * 10.0**-DECADES), 3.0 * top)
    axes.yaxis.set_major_locator(LogLocator(numticks=5))
    axes.yaxis.set_minor_locator(NullLocator())


def _unit(signal: Signal) -> str:
    """As it is printed; "" where nobody said."""
    return style.literal(signal.shown_unit).replace("^2", style.SQUARED) if signal.shown_unit else ""


def _label(signal: Signal) -> str:
    if not signal.quantity:
        return style.literal(signal.column[:14])
    return f"{style.SYMBOLS[signal.quantity]}, {style.literal(signal.place or 'ground')}"
