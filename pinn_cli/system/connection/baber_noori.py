"""Hysteresis that degrades and pinches."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from pinn_cli.settings.legal_values import positive_number
from pinn_cli.system.array_namespace import Array, namespace
from pinn_cli.system.connection.bouc_wen import BoucWen

PINCHING = ("zeta_s", "q", "p", "psi", "delta_psi", "lambda")
# Energy over which a connection may degrade, in cycles of the elongation that there is: the scale of unknown rates.
CYCLES = 2.0
# What pinching starts at, where it is unknown: hardly any, in the middle of the loop, of its full width at once.
FIRST_PINCHING = {"zeta_s": (0.1, 0.5), "q": (0.1, 0.2), "psi": (0.3, 0.3), "delta_psi": (0.0,), "lambda": (0.5, 0.5)}


class BaberNoori(BoucWen):
    """Bouc-Wen hysteresis that loses strength and stiffness with the energy that it has taken, and pinches.

    Baber and Wen (J. Eng. Mech. Div. 107, 1981), Baber and Noori (J. Vib. Acoust. 108, 1986):

        dz/dt = h [A de - nu (beta |de| |z|^(n-1) z + gamma de |z|^n)] / eta
        nu = 1 + delta_nu E,   eta = 1 + delta_eta E,   dE/dt = z de
        h = 1 - zeta_1 exp(-((z sgn(de) / z_u - q) / zeta_2)^2),   z_u = (A / (nu (beta + gamma)))^(1/n)
        zeta_1 = zeta_s (1 - exp(-p E)),   zeta_2 = (psi + delta_psi E) (lambda + zeta_1)

    E (J) is counted from the beginning of the record. delta_nu, delta_eta, p and delta_psi are in 1/J. A connection
    without zeta_s does not pinch (h = 1), and has none of q, p, psi, delta_psi, lambda.

    Args:
        reference: Elongation over which the energy is counted as a force, E / reference, m; None: that of the record's
            motion. An estimator's numbers are of one size then.
        pinches: Whether it does; None: where a connection has zeta_s.

    Raises:
        InputError: ``reference`` is not positive.
    """

    name = "baber_noori"
    optional = PINCHING
    states = 2
    titles: Mapping[str, str] = {
        **BoucWen.titles, "delta_nu": "Loss of strength", "delta_eta": "Loss of stiffness", "zeta_s": "Pinching",
    }  # fmt: skip
    units: Mapping[str, str] = {
        **BoucWen.units, "delta_nu": "1/J", "delta_eta": "1/J",
        "zeta_s": "1", "q": "1", "p": "1/J", "psi": "1", "delta_psi": "1/J", "lambda": "1",
    }  # fmt: skip
    nonnegative = (*BoucWen.nonnegative, "delta_nu", "delta_eta", "zeta_s", "q", "p", "psi", "delta_psi", "lambda")

    def __init__(self, reference: float | None = None, pinches: bool | None = None) -> None:
        self.reference = None if reference is None else positive_number("system.nonlinearity.reference", reference)
        self.pinches = pinches
        self.parameters = (*BoucWen.parameters, "delta_nu", "delta_eta", *(PINCHING if pinches else ()))

    def of_given(self, given: Collection[str]) -> BaberNoori:
        """See :meth:`Nonlinearity.of_given`."""
        return self if self.pinches is not None else BaberNoori(self.reference, "zeta_s" in given)

    def moving_by(self, elongation: float) -> BaberNoori:
        """See :meth:`Nonlinearity.moving_by`."""
        return self if self.reference is not None else BaberNoori(elongation, self.pinches)

    def rate(self, e: Array, de: Array, states: Sequence[Array], parameters: Mapping[str, Array]) -> Sequence[Array]:
        """See :meth:`Hysteresis.rate`."""
        z, counted = states
        reference = self.reference or 1.0
        energy, a, n = counted * reference, parameters["A"], parameters["n"]
        strength, stiffness = (1.0 + parameters[name] * energy for name in ("delta_nu", "delta_eta"))
        weaker = {**parameters, "beta": strength * parameters["beta"], "gamma": strength * parameters["gamma"]}
        (grows,) = super().rate(e, de, [z], weaker)
        grows = grows / stiffness
        if self.pinches:
            xp = namespace(e)
            zeta_s, q, p, psi, delta_psi, rest = (parameters[name] for name in PINCHING)
            depth = zeta_s * (1.0 - xp.exp(-p * energy))
            width = (psi + delta_psi * energy) * (rest + depth)
            ultimate = (a / abs(weaker["beta"] + weaker["gamma"])) ** (1.0 / n)
            grows = grows * (1.0 - depth * xp.exp(-(((z * xp.sign(de) / ultimate - q) / width) ** 2)))
        return grows, z * de / reference

    def starts(self, stiffness: float, elongation: float) -> Mapping[str, tuple[float, ...]]:
        """See :meth:`Nonlinearity.starts`: it neither degrades nor pinches much, and would over some cycles."""
        per_energy = 1.0 / (CYCLES * stiffness * elongation**2)
        rates = dict.fromkeys(("delta_nu", "delta_eta"), (0.0, per_energy)) | {"p": (per_energy, per_energy)}
        pinching = {**FIRST_PINCHING, "delta_psi": (0.0, per_energy)}
        return {**super().starts(stiffness, elongation), **rates, **pinching}

    def creates_energy(self, parameters: Mapping[str, np.ndarray]) -> np.ndarray:
        """See :meth:`Hysteresis.creates_energy`: as without degradation, or where it gains strength or stiffness."""
        gains = (parameters["delta_nu"] < 0) | (parameters["delta_eta"] < 0)
        out: np.ndarray = super().creates_energy(parameters) | gains
        return out
