"""Figures of a look at records: channels over time and frequency, stabilisation diagrams, shapes of modes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, NullLocator, ScalarFormatter

from pinn_cli.report.figures import style
from pinn_cli.report.figures.style import line_indices
from pinn_cli.system.priors import HALF_WIDTH_90

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pinn_cli.inspection.modes import JoinedMode, JoinedModes, ModalRecord
    from pinn_cli.record.cross_spectra import CrossSpectra
    from pinn_cli.record.signal import Sampling, Signal

CHANNELS_DRAWN = 8  # more channels than these are left to inspect.csv
FIRST = 300  # lines of a spectrum that are all drawn
DECADES_OF_SPECTRA, DECADES_OF_MODES = 10.0, 8.0  # that a spectrum, or its singular values, show at most
RECORDS, SINGULAR_VALUES = 6, 3  # of them have a stabilisation diagram, are drawn in it
ROOM = 2.0  # beyond the modes, as a factor of frequency
WIDE_BAND = 8.0  # from this factor on the axis of frequency is logarithmic
MODES, ACROSS, NAMES = 12, 3, 14  # of them are drawn, panels in a row, names of sensors below a panel
LONGEST_LABEL = 8  # letters of a name

_LINE: dict[str, Any] = {"color": style.BLUE, "linewidth": 0.6, "zorder": 2}
_FLOOR: dict[str, Any] = {"color": style.VERMILLION, "linewidth": 0.9, "linestyle": "--", "zorder": 3, "label": "noise"}
_BAND: dict[str, Any] = {
    "color": style.SKY, "alpha": 0.15, "linewidth": 0, "zorder": 0, "label": "band: signal above its noise",
}  # fmt: skip
_PEAK: dict[str, Any] = {"color": style.GREY, "linewidth": 0.5, "zorder": 1, "label": "natural frequency found"}
_OF_STRUCTURE: dict[str, Any] = {
    "color": style.ORANGE, "linewidth": 0.9, "linestyle": ":", "zorder": 1, "label": "of the structure given",
}  # fmt: skip
_UNSTABLE: dict[str, Any] = {"linestyle": "none", "marker": ".", "markersize": 2.2, "color": "#BFBFBF", "zorder": 2}
_STABLE: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 2.4, "color": style.GREEN,
                           "markeredgewidth": 0, "zorder": 3}  # fmt: skip
_FIRST: dict[str, Any] = {"color": style.BLUE, "linewidth": 0.8}
_FURTHER: dict[str, Any] = {"color": style.SKY, "linewidth": 0.6}
_MODE: dict[str, Any] = {"color": style.VERMILLION, "linewidth": 0.8, "zorder": 1}
_MACHINE: dict[str, Any] = {"color": style.ORANGE, "linewidth": 0.8, "linestyle": ":", "zorder": 1}
_SHAPE: dict[str, Any] = {"color": style.BLUE, "linewidth": 0.8, "marker": "o", "markersize": 3.0, "capsize": 1.5,
                          "elinewidth": 0.6, "zorder": 2, "label": "shape and its 90 % interval"}  # fmt: skip
_ZERO: dict[str, Any] = {"color": style.GREY, "linewidth": 0.5, "zorder": 0}
_MODE_MARKS = ("x", "+", "1", "2", "3", "4")
_COLOURS = (style.VERMILLION, style.GREEN, style.PURPLE, style.ORANGE, style.BLACK, style.SKY)


@style.look()
def inspection_figure(
    sampling: Sampling, channels: pd.DataFrame, spectra: CrossSpectra[Signal], peaks: pd.DataFrame
) -> Figure:
    """Histories and power spectra; shaded, the band; dashed, the noise. Peaks are grey, the structure's dotted.

    Arguments are those of :class:`pinn_cli.inspection.report.InspectionReport`.
    """
    shown = [*spectra.acting, *spectra.sensors][:CHANNELS_DRAWN]
    responses = bool(spectra.acting) and bool(spectra.sensors)
    figure, panels = style.panels(
        len(shown) + responses, 2, 0.95, margins=(0.66, 0.1, 0.56, 0.5), gaps=(0.6, 0.34), width_ratios=(1.2, 1.0)
    )
    for (left, right), signal in zip(panels, shown, strict=False):
        _draw_history(left, sampling, signal)
        row = channels[channels["column"] == signal.column].iloc[0].to_dict()
        row["floor"] = 2.0 * row["noise"] ** 2 / sampling.rate
        _draw_spectrum(right, spectra, signal, row, peaks)
    rows = panels[: len(shown)]
    rows[-1, 0].set_xlabel("Time $t$ (s)", labelpad=2)
    rows[-1, 1].set_xlabel("Frequency (Hz)", labelpad=2)
    if responses:
        _draw_responses(panels[-1, 0], panels[-1, 1], spectra, peaks)
        box = [axes.get_position() for axes in panels[-1]]
        lower = 0.55 * (panels[-2, 0].get_position().y0 - box[0].y1)  # room for the labels of the rows above
        for axes, place in zip(panels[-1], box, strict=True):
            axes.set_position((place.x0, place.y0, place.width, place.height - 0.25 * lower))
    for axes, title in zip(panels[0], ("History", "Power spectral density"), strict=True):
        style.head(axes, title)
    figure.align_ylabels(list(panels[:, 0]))
    style.legend(figure, rows.flat)
    return figure


def _draw_history(axes: Axes, sampling: Sampling, signal: Signal) -> None:
    kept = line_indices(np.where(np.isfinite(signal.values), signal.values, np.nanmean(signal.values)))
    axes.plot(sampling.time[kept], signal.values[kept], **_LINE)
    axes.set_xlim(sampling.time[0], sampling.time[-1])
    axes.yaxis.set_major_locator(MaxNLocator(4))
    axes.xaxis.set_major_locator(MaxNLocator(6))
    axes.ticklabel_format(axis="y", style="sci", scilimits=(-3, 4))
    axes.set_ylabel(_label(signal))
    if unit := _unit(signal):
        axes.set_title(f"({unit})", loc="left", fontsize=7, pad=2)


def _draw_spectrum(
    axes: Axes, spectra: CrossSpectra[Signal], signal: Signal, row: Mapping[Any, Any], peaks: pd.DataFrame
) -> None:
    i = next(i for i, other in enumerate([*spectra.sensors, *spectra.acting]) if other is signal)
    power = spectra.density[1:, i]
    _draw_lines(axes, spectra, power, _LINE)
    if np.isfinite(row["band_high_hz"]):
        axes.axvspan(row["band_low_hz"], row["band_high_hz"], **_BAND)
    if row["noise"] > 0.0:
        axes.axhline(row["floor"], **_FLOOR)
    if unit := _unit(signal):
        axes.set_title(f"({unit})\N{SUPERSCRIPT TWO}/Hz", loc="left", fontsize=7, pad=2)
    _draw_peaks(axes, peaks)
    _logarithmic(axes, float(power.max()), (spectra.frequency[1], spectra.frequency[-1]))


def _draw_responses(magnitude: Axes, coherence: Axes, spectra: CrossSpectra[Signal], peaks: pd.DataFrame) -> None:
    size = np.sqrt(np.sum(np.abs(spectra.response[1:]) ** 2, axis=2))
    for k, sensor in enumerate(spectra.sensors[:CHANNELS_DRAWN]):
        look: dict[str, Any] = {"color": style.CYCLE[k % len(style.CYCLE)], "linewidth": 0.7, "label": _label(sensor)}
        _draw_lines(magnitude, spectra, size[:, k], look)
        _draw_lines(coherence, spectra, spectra.coherence[1:, k], look)
    magnitude.legend(loc="best", fontsize=6, ncols=2, handlelength=1.2)  # peaks have their place above
    for axes in (magnitude, coherence):
        _draw_peaks(axes, peaks)
        axes.set_xlabel("Frequency (Hz)", labelpad=2)
    _logarithmic(magnitude, float(np.nanmax(size)), (spectra.frequency[1], spectra.frequency[-1]))
    magnitude.set_ylabel("response")
    sensed, acting = (
        {_unit(signal) for signal in signals} for signals in (spectra.sensors[:CHANNELS_DRAWN], spectra.acting)
    )
    if len(sensed) == len(acting) == 1 and "" not in sensed | acting:  # else each line has a unit of its own
        magnitude.set_title(f"({sensed.pop()}) / {acting.pop()}", loc="left", fontsize=7, pad=2)
    coherence.set_xscale("log")
    coherence.set_xlim(spectra.frequency[1], spectra.frequency[-1])
    coherence.set_ylim(0.0, 1.02)
    coherence.set_ylabel("coherence")


def _draw_lines(axes: Axes, spectra: CrossSpectra[Signal], values: np.ndarray, look: Mapping[str, Any]) -> None:
    """Positive values (B - 1,), from the first line on, by their outline: every line at first, extremes further on."""
    kept = np.concatenate([np.arange(min(FIRST, len(values))), FIRST + line_indices(values[FIRST:])])
    axes.plot(spectra.frequency[1:][kept], np.where(values > 0.0, values, np.nan)[kept], **look)


def _draw_peaks(axes: Axes, peaks: pd.DataFrame) -> None:
    for frequency in peaks["frequency_hz"]:
        axes.axvline(frequency, **_PEAK)
    for frequency in peaks["structure_hz"].dropna().unique():
        axes.axvline(frequency, **_OF_STRUCTURE)


def _logarithmic(axes: Axes, top: float, within: tuple[float, float]) -> None:
    axes.set_xscale("log")
    axes.set_xlim(*within)
    if not top > 0.0:
        return
    axes.set_yscale("log")
    axes.set_ylim(max(axes.get_ylim()[0], top * 10.0**-DECADES_OF_SPECTRA), 3.0 * top)
    axes.yaxis.set_major_locator(LogLocator(numticks=5))
    axes.yaxis.set_minor_locator(NullLocator())


def _unit(signal: Signal) -> str:
    """As it is printed; "" where nobody said."""
    return style.literal(signal.shown_unit).replace("^2", style.SQUARED) if signal.shown_unit else ""


def _label(signal: Signal) -> str:
    if not signal.quantity:
        return style.literal(signal.column[:14])
    return f"{style.SYMBOLS[signal.quantity]}, {style.literal(signal.place or 'ground')}"


@style.look()
def stabilisation_figure(records: Sequence[ModalRecord]) -> Figure:
    """A panel for each record."""
    shown = records[:RECORDS]
    figure, panels = style.panels(len(shown), 1, 2.3, margins=(0.5, 0.62, 0.34, 0.44), gaps=(0.0, 0.42))
    for number, (axes, record) in enumerate(zip(panels[:, 0], shown, strict=True), start=1):
        _draw_poles(axes, record)
        if len(records) > 1:
            axes.set_title(f"Record {number}", loc="left", pad=3)
    panels[-1, 0].set_xlabel("Frequency (Hz)", labelpad=2)
    style.legend(figure, handlelength=1.4, columnspacing=1.4)
    if len(records) > RECORDS:
        style.note(figure, f"{len(records) - RECORDS} further records are left out")
    return figure


def _draw_poles(axes: Axes, record: ModalRecord) -> None:
    poles = record.identified.stabilisation
    low, high = _reach(record)
    within = (poles.frequency >= low) & (poles.frequency <= high)
    for stable, look, label in ((False, _UNSTABLE, "pole"), (True, _STABLE, "stable pole")):
        some = within & (poles.stable == stable)
        axes.plot(poles.frequency[some], poles.order[some], label=label, **look)
    for i, mode in enumerate(record.modes):
        axes.axvline(mode.frequency, label="mode" if i == 0 else None, **_MODE)
    for i, frequency in enumerate(record.identified.machines):
        axes.axvline(frequency, label="steady line, no mode" if i == 0 else None, **_MACHINE)
    axes.set_ylim(0, float(np.max(poles.order, initial=2)) + 1)
    axes.set_ylabel("order")
    axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))
    twin = axes.twinx()
    values, f = record.decomposition[0], record.spectra.frequency
    seen = np.flatnonzero((f >= low) & (f <= high) & (f > 0))
    for k in range(min(values.shape[1], SINGULAR_VALUES)):
        line = values[seen, k] ** (2 if record.acting else 1)
        positive = np.where(line > 0.0, line, np.nan)
        kept = line_indices(np.nan_to_num(positive))
        look = _FIRST if k == 0 else _FURTHER
        twin.plot(
            f[seen][kept], positive[kept], label="singular values of the spectra" if k == 0 else None, zorder=0, **look
        )
    twin.set_yscale("log")
    top = float(np.nanmax(values[seen, 0], initial=1e-300)) ** (2 if record.acting else 1)
    twin.set_ylim(max(twin.get_ylim()[0], top * 10.0**-DECADES_OF_MODES), 3.0 * top)
    twin.set_ylabel("singular value")
    twin.yaxis.set_minor_locator(NullLocator())
    axes.set_zorder(twin.get_zorder() + 1)
    axes.patch.set_visible(False)
    if high > WIDE_BAND * low:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(ScalarFormatter())
        axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlim(low, high)


def _reach(record: ModalRecord) -> tuple[float, float]:
    """Frequencies that are drawn, Hz."""
    f = record.spectra.frequency
    frequencies = [mode.frequency for mode in record.modes] or [f[1] * 4.0, f[-1]]
    return max(min(frequencies) / ROOM, float(f[1])), float(min(max(frequencies) * ROOM, f[-1]))


@style.look()
def shapes_figure(record: ModalRecord | JoinedModes, joined: Sequence[JoinedMode] = ()) -> Figure:
    """A panel for each mode; of modes of several records, which are ``joined``, every record's own shape as points."""
    shown = min(len(record.modes), MODES)
    rows, across = -(-shown // ACROSS), min(shown, ACROSS)
    figure, panels = style.panels(rows, across, 1.25, margins=(0.42, 0.1, 0.46, 0.46), gaps=(0.34, 0.5), sharey=True)
    for number, axes in enumerate(panels.flat):
        if number >= shown:
            axes.set_axis_off()
            continue
        _draw_shape(axes, record, number)
        for part, scale in zip(joined[number].parts, joined[number].scales, strict=True) if joined else ():
            # A record's own shape, as large as the joined one.
            look, shape = part.record % len(_MODE_MARKS), (part.shape / scale).real
            axes.plot(part.places, shape, linestyle="none", marker=_MODE_MARKS[look], color=_COLOURS[look],
                      markersize=4.0, zorder=3, label=f"record {part.record + 1}")  # fmt: skip
    for axes in panels[:, 0]:
        axes.set_ylabel("displacement")
    style.legend(figure, handlelength=1.4, columnspacing=1.2)
    if len(record.modes) > MODES:
        style.note(figure, f"{len(record.modes) - MODES} further modes are left to modes.csv")
    return figure


def _draw_shape(axes: Axes, record: ModalRecord | JoinedModes, number: int) -> None:
    shape, std = record.shapes[number].real, record.shape_std(number)
    at = np.flatnonzero(np.isfinite(shape))
    axes.axhline(0.0, **_ZERO)
    axes.errorbar(at, shape[at], HALF_WIDTH_90 * std[at], **_SHAPE)
    axes.set_title(f"{record.modes[number].frequency:.4g} Hz", loc="left", pad=3)
    stride = -(-len(shape) // NAMES)
    places = range(0, len(shape), stride)
    axes.set_xticks(places, [style.literal(record.names[i][:LONGEST_LABEL]) for i in places])
    if max(len(name) for name in record.names) > 2:
        axes.tick_params(axis="x", rotation=90)
    axes.set_xlim(-0.5, len(shape) - 0.5)
    axes.set_ylim(-1.4, 1.4)
