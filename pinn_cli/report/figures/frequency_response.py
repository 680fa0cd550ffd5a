"""Frequency responses within the band of a record: measured, and those of the estimated structure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pinn_cli.record.response import RESPONSE_QUANTITIES
from pinn_cli.report.figures import style
from pinn_cli.system.modes import modes_of

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
    sensors = [(q, int(dof)) for q in RESPONSE_QUANTITIES for dof in np.flatnonzero(record.sensors(q))][:MOST]
    frequency, measured, estimated = frequency_responses(record, structure, sensors)
    with style.look():
        figure, panels = style.panels(
            2, len(sensors), 1.5, margins=(0.55, 0.08, 0.45, 0.4), gaps=(0.5, 0.12), sharex="col"
        )
        for i, (quantity, dof) in enumerate(sensors):
            above, below = panels[:, i]
            for values, look in ((measured, style.DOTS | {"color": style.GREY}), (estimated, {"color": style.BLUE})):
                above.semilogy(frequency, np.abs(values[:, i]), **look)
                below.plot(frequency, np.degrees(np.angle(values[:, i])), **look)
            above.set_title(f"{style.SYMBOLS[quantity]} of {record.dof_names([dof])}, {style.unit(quantity)}/N", pad=3)
            below.set_yticks([-180, -90, 0, 90, 180])
            below.set_xlabel("Frequency (Hz)", labelpad=2)
        panels[0, 0].set_ylabel("Amplitude")
        panels[1, 0].set_ylabel("Phase (°)")
        figure.legend([*panels[0, 0].lines], ["measured", "estimated"], loc="upper center", ncols=2)
    return figure


def frequency_responses(
    record: Record, structure: Structure, sensors: list[tuple[str, int]]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Hz (F,), and responses (F, sensors) per newton: measured (averages over neighbouring lines), and estimated."""
    assert record.band is not None
    driven = int(np.flatnonzero(record.sensors("force"))[0])
    columns = np.stack([record.force[:, driven], *(getattr(record, q)[:, dof] for q, dof in sensors)], axis=1)
    spectra = np.fft.rfft(columns * np.hanning(len(columns))[:, None], axis=0)
    average = np.ones(AVERAGED) / AVERAGED
    cross, power = (
        np.stack([np.convolve(x, average, mode="same") for x in (y * spectra[:, :1].conj()).T], axis=1)
        for y in (spectra[:, 1:], spectra[:, :1])
    )
    frequency = np.fft.rfftfreq(len(columns), record.step)
    low, high = record.band.edges
    within = (frequency >= low) & (frequency <= high)
    s, modes = 2j * np.pi * frequency[within], modes_of(structure)
    orders = np.array([RESPONSE_QUANTITIES.index(quantity) for quantity, _ in sensors])
    at = modes.shapes[[dof for _, dof in sensors]] * modes.pushed[:, driven]
    estimated = (1.0 / (s[:, None] - modes.poles)) @ at.T * s[:, None] ** orders
    return frequency[within], (cross / power.real)[within], estimated
