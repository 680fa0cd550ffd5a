"""The identified system on data that no estimator has seen: what it does there beside what the sensors measured."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from pinn_cli.record.channels import Channel, channels
from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.report.figures import style
from pinn_cli.report.figures.decimate import line_indices
from pinn_cli.report.figures.response import PERIODS_IN_FULL, PERIODS_SHOWN, periods_of
from pinn_cli.report.residuals import nmse_percent
from pinn_cli.report.validation_run import BAND
from pinn_cli.verdict.noise_findings import noise_found

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from pinn_cli.report.validation_run import ValidationRun
    from pinn_cli.training.estimate import Estimate

ROWS_IN_FULL = 8  # more sensors than these: those with the largest NMSE

_MEASURED: dict[str, Any] = {"color": style.BLACK, "linewidth": 0.9, "zorder": 2.0}
_RUN: dict[str, Any] = {"color": style.VERMILLION, "linewidth": 0.8, "linestyle": (0, (2.5, 1.2)), "zorder": 2.2}
_BAND: dict[str, Any] = {"color": style.VERMILLION, "alpha": 0.3, "linewidth": 0, "zorder": 1.9}
_ERROR: dict[str, Any] = {"color": style.BLUE, "linewidth": 0.6, "zorder": 2.0}
_WITH_NOISE: dict[str, Any] = {"color": style.VERMILLION, "linewidth": 0.9, "linestyle": "--", "zorder": 3.0}


def validation_figure(run: ValidationRun, estimate: Estimate) -> Figure:
    """A row for each response sensor: its history beside the run's with its 95 % band, and what is between them.

    The band of the error holds the sensor's noise as well. Of a record with too many periods the histories show the
    last ones, where errors of the parameters have added up; the error is shown as a whole. Of more than `ROWS_IN_FULL`
    sensors those with the largest NMSE are shown.

    Args:
        run: With a response.
        estimate: In whose summary the noise found is.
    """
    every = channels(run.record, RESPONSE_QUANTITIES)
    errors = [nmse_percent(m - s, m) for m, s, _ in map(run.of_channel, every)]
    shown = [every[i] for i in sorted(np.argsort(-np.nan_to_num(errors), kind="stable")[:ROWS_IN_FULL])]
    count = _shown_samples(run, shown)
    with style.look():
        figure, panels = style.panels(
            len(shown), 2, 0.95, margins=(0.62, 0.08, 0.56, 0.42), gaps=(0.5, 0.28), width_ratios=(1.25, 1.0)
        )
        for (history, error), channel in zip(panels, shown, strict=True):
            _draw_history(history, run, channel, count)
            place = channel.label if run.record.dofs else f"DOF {channel.where}"
            history.set_ylabel(f"{style.SYMBOLS[channel.quantity]}, {place}")
            _draw_error(error, run, channel, noise_found(estimate, channel))
        for axes, title in zip(panels[0], ("Validation data", "Error"), strict=True):
            axes.annotate(title, (0.5, 1.0), xycoords="axes fraction", xytext=(0, 14), textcoords="offset points",
                          ha="center", fontsize=8.5)  # fmt: skip
        for axes in panels[-1]:
            axes.set_xlabel("Time $t$ (s)", labelpad=2)
        figure.align_ylabels(list(panels[:, 0]))
        _legend(figure, run)
        if len(shown) < len(every):
            note = f"the {len(shown)} of {len(every)} sensors with the largest NMSE"
            figure.text(0.01, 0.002, note, ha="left", va="bottom", fontsize=7)
    return figure


def _shown_samples(run: ValidationRun, shown: list[Channel]) -> int:
    """How many of the last samples the histories show."""
    simulated = np.stack([_whole(run, channel)[1] for channel in shown], axis=1)
    periods = periods_of(np.diff(simulated, axis=0))
    return len(simulated) if periods <= PERIODS_IN_FULL else max(2, int(len(simulated) * PERIODS_SHOWN / periods))


def _draw_history(axes: Axes, run: ValidationRun, channel: Channel, count: int) -> None:
    measured, simulated, std = (x[-count:] for x in _whole(run, channel))
    time = run.record.time[-count:]
    factor, prefix = style.unit_prefix(float(np.nanmax(np.abs(measured), initial=0.0)))
    kept = line_indices(simulated)
    axes.plot(time[kept], factor * measured[kept], **_MEASURED)
    if np.isfinite(std).any():
        low, high = (factor * (simulated + sign * BAND * std)[kept] for sign in (-1, 1))
        axes.fill_between(time[kept], low, high, **_BAND)
    axes.plot(time[kept], factor * simulated[kept], **_RUN)
    _set_axes(axes, time)
    axes.set_title(f"({style.unit(channel.quantity, prefix)})", loc="left", fontsize=7, pad=2)


def _draw_error(axes: Axes, run: ValidationRun, channel: Channel, sigma: float) -> None:
    measured, simulated, std = _whole(run, channel)
    error, reach = measured - simulated, BAND * np.hypot(std, np.nan_to_num(sigma))
    time = run.record.time[run.first :]
    factor, prefix = style.unit_prefix(float(np.nanmax(np.abs(error), initial=0.0)))
    known = np.isfinite(error)
    kept = np.flatnonzero(known)[line_indices(error[known])]
    if np.isfinite(reach).any():
        for sign in (-1.0, 1.0):
            axes.plot(time[kept], sign * factor * reach[kept], **_WITH_NOISE)
    axes.plot(time[kept], factor * error[kept], **_ERROR)
    _set_axes(axes, time)
    axes.set_title(f"({style.unit(channel.quantity, prefix)})", loc="left", fontsize=7, pad=2)
    value = nmse_percent(error[known], measured[known])
    if np.isfinite(value):
        axes.set_title(f"NMSE {value:.3g} %", loc="right", fontsize=7, pad=2)


def _whole(run: ValidationRun, channel: Channel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measured, NaN where no sample was taken, simulated, and its deviation, from the first sample compared on."""
    assert run.response is not None
    measured = channel.measured if channel.there is None else np.where(channel.there, channel.measured, np.nan)
    simulated = channel.of(run.response)
    std = np.full(len(measured), np.nan) if run.std is None else channel.of(run.std)
    return measured[run.first :], simulated[run.first :], std[run.first :]


def _set_axes(axes: Axes, time: np.ndarray) -> None:
    axes.set_xlim(time[0], time[-1])
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10], min_n_ticks=3))


def _legend(figure: Figure, run: ValidationRun) -> None:
    handles: list[Line2D | Patch] = [
        Line2D([], [], label="measured", **_MEASURED), Line2D([], [], label="identified system", **_RUN)
    ]  # fmt: skip
    if run.std is not None:
        handles.append(Patch(label="95 % band", **_BAND))
    handles.append(Line2D([], [], label="error", **_ERROR))
    if run.std is not None:
        handles.append(Line2D([], [], label="95 % band with the sensor's noise", **_WITH_NOISE))
    figure.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 1.0), ncols=len(handles))
