"""Parameters that spectra determine, before the motion is estimated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pinn_cli.system.parameters import Parameter


@dataclass(frozen=True, eq=False)
class SpectralEstimate:
    """What spectra say of parameters; the motion under a measured force then says no more of them.

    Attributes:
        parameters: Whose prescribed values are the most probable ones.
        covariance: (p, p), in the parameters' units.
        log_likelihood: Of the spectra.
        levels: Quantity to (dofs,), standard deviation of the white noise of its sensors; NaN where there is none.
        misfit: Part of the sensors' power that is left in the part of the spectra that fits worst, beyond noise.
        missing: Frequency, Hz, of a mode that the spectra show and the structure does not have; None: there is none.
    """

    parameters: tuple[Parameter, ...]
    covariance: np.ndarray
    log_likelihood: float
    levels: Mapping[str, np.ndarray]
    misfit: float
    missing: float | None = None
