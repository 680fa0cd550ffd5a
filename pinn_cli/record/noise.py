"""Sensor noise: white, Gaussian, at a signal-to-noise ratio."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pinn_cli.errors import InputError
from pinn_cli.legal_values import is_finite_number, whole_number
from pinn_cli.record.record import QUANTITIES, Response


@dataclass(frozen=True)
class Noise:
    """White Gaussian noise with SNR = 10 log10(signal power / noise power) per channel; power is the mean square.

    Attributes:
        snr_db: dB; None for no noise.
        seed: Each channel draws from a stream of its own, derived from (seed, quantity, DOF), so that a channel's noise
            does not depend on which others there are.
        seeds: None, or quantity to seed: channel i (from 0) then draws from legacy ``RandomState(seeds[quantity] + i)``
            as the authors' do.

    Raises:
        InputError: Naming ``noise.snr_db``, ``seed`` or ``noise.seeds``.
    """

    snr_db: float | None = None
    seed: int = 0
    seeds: Mapping[str, int] | None = None

    def __post_init__(self) -> None:
        if self.snr_db is not None and not is_finite_number(self.snr_db):
            raise InputError("noise.snr_db", self.snr_db, "a finite number of dB, or null for no noise")
        whole_number("seed", self.seed)
        if self.seeds is not None:
            if not isinstance(self.seeds, Mapping) or set(self.seeds) != set(QUANTITIES):
                raise InputError("noise.seeds", self.seeds, f"null or one seed for each of {', '.join(QUANTITIES)}")
            for quantity, seed in self.seeds.items():
                whole_number(f"noise.seeds.{quantity}", seed)

    def added_to(self, response: Response) -> Response:
        """The response as sensors would show it; see :func:`add_noise`."""
        return add_noise(response, self.snr_db, self.seed, self.seeds)


def add_noise(
    response: Response, snr_db: float | None, seed: int = 0, seeds: Mapping[str, int] | None = None
) -> Response:
    """The response with noise on every channel that is not identically zero, so on forces of forced DOFs only.

    Args:
        response: (N, n) each; not changed.
        snr_db: See :class:`Noise`.
        seed: See :class:`Noise`.
        seeds: See :class:`Noise`.
    """
    if snr_db is None:
        return response
    noisy = {}
    for quantity in QUANTITIES:
        values = getattr(response, quantity).copy()
        for i in np.flatnonzero(np.any(values != 0.0, axis=0)):
            deviation = math.sqrt(np.mean(values[:, i] ** 2) / 10.0 ** (snr_db / 10.0))
            values[:, i] += deviation * _standard_normal(quantity, int(i), len(values), seed, seeds)
        noisy[quantity] = values
    return replace(response, **noisy)


def _standard_normal(quantity: str, i: int, samples: int, seed: int, seeds: Mapping[str, int] | None) -> np.ndarray:
    if seeds is not None:
        return np.random.RandomState(seeds[quantity] + i).standard_normal(samples)
    return np.random.default_rng([seed, QUANTITIES.index(quantity), i]).standard_normal(samples)
