"""What the spectra of a record of finite length are on average, where a resonance leaks into the lines beside it.

A line of a tapered record is the mean of the true spectrum over its neighbours: its expectation is the transform of the
covariance over the lag times that of the taper (Sykulski et al., Biometrika 106, 2019). What a measured force f makes
of a sensor leaks likewise. Taken off line by line as G f it leaves, with Q the power of f and < > that mean,

    <G Q G^H> - <G Q> G^H - G <Q G^H> + G <Q> G^H.
"""

from __future__ import annotations

import numpy as np

from pinn_cli.record.cross_spectra import taper
from pinn_cli.training.whittle.spectral_model import TAPERED, SpectralModel, band_lines

# Lines beside the band whose leakage reaches it: that of the taper falls off steeply from 10 over its part on.
BESIDE = 200
# Samples of a record of which every resonance is so many lines wide that none leaks.
LONG = 2**17


class ExpectedSpectra:
    """Of one record and its taper, for any model of it.

    Args:
        model: Of the spectra in the record's band.

    Raises:
        ValueError: The band holds too little for a model.
    """

    def __init__(self, model: SpectralModel) -> None:
        edges, samples = band_lines(model.problem.record), len(model.spectrum.values)
        if edges is None:
            raise ValueError("there is no model of a band without lines")
        self.edges, self.is_long, stop = edges, samples > LONG, edges[-1]
        half = np.arange(min(2 * (stop + BESIDE), samples) + 1)  # two to a line: as many lags as the samples have pairs
        half[0] = 1  # what is asked at a frequency of zero has no logarithm
        self.frequency = half / (2.0 * samples * model.spectrum.step)
        self.mean = Leakage(taper(samples, TAPERED), stop)

    def __call__(self, model: SpectralModel, x: np.ndarray) -> np.ndarray:
        """(G, S, S), of the sensors' spectra less what measured forces make of them, at the unknowns (q,)."""
        if self.is_long:
            return model.power(x)[0]
        value, seen = model.at(self.frequency).power(x)
        mean, stop = self.mean, self.edges[-1]
        out = mean(value)
        if seen.shape[-1]:
            loads = np.stack([[np.interp(self.frequency, model.spectrum.frequency, y) for y in row]
                              for row in np.moveaxis(model.spectrum.of_acting, 0, 2)])  # fmt: skip
            acting, line = np.moveaxis(loads, 2, 0), seen[: 2 * stop : 2]
            back, pushed = line.conj().transpose(0, 2, 1), seen @ acting
            crossed = mean(pushed) @ back
            out += mean(pushed @ seen.conj().transpose(0, 2, 1)) - crossed - crossed.conj().transpose(0, 2, 1)
            out += line @ mean(acting) @ back
        averaged: np.ndarray = np.add.reduceat(out, self.edges[:-1], axis=0) / np.diff(self.edges)[:, None, None]
        return averaged


class Leakage:
    """From a spectrum at half lines to its mean at lines under a taper (N,), up to one."""

    def __init__(self, window: np.ndarray, stop: int) -> None:
        self.samples, self.stop = len(window), stop
        doubled = np.abs(np.fft.rfft(window, 2 * len(window))) ** 2
        self.lags = np.fft.irfft(doubled) / np.sum(window**2)

    def __call__(self, spectrum: np.ndarray) -> np.ndarray:
        """(stop, A, B) from (half lines, A, B), of which those that are not there are zero."""
        out = np.empty((self.stop, *spectrum.shape[1:]), complex)
        for i, j in np.ndindex(*spectrum.shape[1:]):
            lags = np.fft.irfft(spectrum[:, i, j], 2 * self.samples) * self.lags
            out[:, i, j] = np.fft.rfft(lags[: self.samples] + lags[self.samples :])[: self.stop]
        return out
