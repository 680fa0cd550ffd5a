"""Frequency responses within the band of a record: measured, and those of the estimated structure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.channels import channels
from pinn_cli.record.cross_spectra import CrossSpectra
from pinn_cli.report.figures import style
from pinn_cli.system.modes import modes_of
from pinn_cli.system.quantities import FORCE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pinn_cli.record.record import Record
    from pinn_cli.system.structure import Structure

# Sensors that are shown, and lines of the spectrum that are averaged to one measured value.
MOST, AVERAGED = 6, 3


def frequency_response_figure(record: Record, structure: Structure) -> Figure:
    """Amplitude and phase of every sensor over the measured force.

    Args:
        record: With a band and one measured force.
        structure: With the estimated parameters.
    """
    assert record.band is not None
    sensors, load = channels(record)[:MOST], channels(record, (FORCE,))
    first, stop = np.searchsorted(np.fft.rfftfreq(len(record.time), record.step), record.band.edges)
    spectra = CrossSpectra.of_bands(record, sensors, load, range(first, stop + 1, AVERAGED))
    modes = modes_of(structure)
    at = modes.shapes[[sensor.dof for sensor in sensors]] * modes.pushed[:, load[0].dof]
    estimated = (1.0 / (1j * spectra.omega[:, None] - modes.poles)) @ at.T * spectra.differentiation
    shown = (spectra.response[..., 0], style.DOTS | {"color": style.GREY}), (estimated, {"color": style.BLUE})
    with style.look():
        figure, panels = style.panels(
            2, len(sensors), 1.5, margins=(0.55, 0.08, 0.45, 0.4), gaps=(0.5, 0.12), sharex="col"
        )
        for i, sensor in enumerate(sensors):
            above, below = panels[:, i]
            for values, look in shown:
                above.semilogy(spectra.frequency, np.abs(values[:, i]), **look)
                below.plot(spectra.frequency, np.degrees(np.angle(values[:, i])), **look)
            title = f"{style.SYMBOLS[sensor.quantity]} of {record.dof_names([sensor.dof])}"
            above.set_title(f"{title}, {style.unit(sensor.quantity)}/N", pad=3)
            below.set_yticks([-180, -90, 0, 90, 180])
            below.set_xlabel("Frequency (Hz)", labelpad=2)
        panels[0, 0].set_ylabel("Amplitude")
        panels[1, 0].set_ylabel("Phase (°)")
        figure.legend([*panels[0, 0].lines], ["measured", "estimated"], loc="upper center", ncols=2)
    return figure
