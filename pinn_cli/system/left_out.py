"""Forces that the model of a connection may have left out, of the motion that it makes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

# Speed over which friction changes its sign, in rms speeds of its connection.
CREEP = 0.05
# Kinds of such forces, as people call them.
CUBIC, QUADRATIC, FRICTION = "cubic term", "quadratic damping", "friction"
# Those of its own parameters that are held.
SPRING, DAMPER = "k", "c"
ONE_SIDED, BACKLASH, HYSTERESIS, DRIFT = "one-sided spring", "backlash", "hysteresis", "drift"
ONE_SIDED_DAMPER = "one-sided damper"
STRIBECK = "Stribeck"
# What a DOF may carry: an oscillator that is attached to it, and a mass that lies on it.
MODE, SLIDING = "mode", "sliding mass"
# A base that turns under the structure; a spring where no connection is.
ROCKING, LINK = "rocking", "link"
# A force of any history on one DOF.
PLACE = "force"
# What damps a mode of the structure beside its dampers.
DAMPED_MODE = "damping ratio"
# Accelerations beyond which such a mass slides, as they are tried, over the rms acceleration.
SLIDES_AT = (0.6, 1.5)


@dataclass(frozen=True, eq=False)
class LeftOut:
    """A force that a connection may have beside those of its model.

    Attributes:
        kind: What it is.
        unit: Of its size.
        force: Of elongation, rate and shape to (N,), N, of size one.
        shapes: What the force does not grow with, as it is tried: gaps, or elongations at which it slips, over the rms
            elongation; of most there is none.
        parameter: Kind of the parameter that says its size in a law that has it.
        least, most: Of its size: what rubs, slips or has play resists.
    """

    kind: str
    unit: str
    force: Callable[[np.ndarray, np.ndarray, float], np.ndarray]
    shapes: tuple[float, ...] = (np.nan,)
    parameter: str = ""
    least: float = -np.inf
    most: float = np.inf


LEFT_OUT = (
    LeftOut(SPRING, "N/m", lambda e, de, _: e, parameter=SPRING),
    LeftOut(DAMPER, "N s/m", lambda e, de, _: de, parameter=DAMPER),
    LeftOut(CUBIC, "N/m^3", lambda e, de, _: e**3, parameter="kappa"),
    LeftOut(QUADRATIC, "N (s/m)^2", lambda e, de, _: abs(de) * de),
    LeftOut(FRICTION, "N", lambda e, de, _: _rubbing(de), parameter="F_c", least=0.0),
    LeftOut(STRIBECK, "N", lambda e, de, at: _rubbing(de) * np.exp(-((rms(e) / rms(de) * de / at) ** 2)), (0.1, 0.4)),
    LeftOut(ONE_SIDED, "N/m", lambda e, de, _: np.maximum(e, 0.0)),
    LeftOut(ONE_SIDED_DAMPER, "N s/m", lambda e, de, _: np.maximum(de, 0.0)),
    LeftOut(BACKLASH, "N", lambda e, de, gap: -np.clip(e / gap, -1.0, 1.0), (0.03, 0.2), least=0.0),
    LeftOut(HYSTERESIS, "N", lambda e, de, at: _slipping(e / at), (0.3, 1.0), least=0.0),
    LeftOut(DRIFT, "N/m", lambda e, de, _: e * np.linspace(-0.5, 0.5, len(e))),
)


def rms(x: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(x**2)))


def _rubbing(de: np.ndarray) -> np.ndarray:
    return np.tanh(de / (CREEP * max(rms(de), 1e-300)))


def _slipping(e: np.ndarray) -> np.ndarray:
    """Force of a spring of stiffness one that slips at one (Jenkins), which begins without force."""
    out, force = np.empty(len(e)), 0.0
    for i, step in enumerate(np.diff(e, prepend=e[0]).tolist()):
        force = min(1.0, max(-1.0, force + step))
        out[i] = force
    return out


def sliding(acceleration: np.ndarray, step: float, at: float) -> np.ndarray:
    """(N,) acceleration of a mass that lies on what moves so and slides beyond ``at``, m/s^2, until both move alike."""
    out, behind = np.empty(len(acceleration)), 0.0
    for i, carried in enumerate(acceleration.tolist()):
        out[i] = min(at, max(-at, carried + behind / step))
        behind += (carried - out[i]) * step
    return out


class Carried:
    """What DOFs carry along, from how these move.

    Args:
        acceleration: (N, n), of the DOFs, m/s^2.
        step: Between samples, s.
    """

    def __init__(self, acceleration: np.ndarray, step: float) -> None:
        from scipy.fft import next_fast_len

        self._samples = len(acceleration)
        self._length = next_fast_len(2 * self._samples, real=True)
        self._frequency = np.fft.rfftfreq(self._length, step)
        self._spectrum = np.fft.rfft(acceleration, self._length, axis=0).T.copy()

    def oscillator(self, dof: int, frequency: float, damping: float) -> np.ndarray:
        """(N,), force, N, that takes an oscillator of one kg along with a DOF, at rest at first.

        Its frequency, Hz, is that where the DOF is held; ``damping`` is its ratio.
        """
        ratio = self._frequency / frequency
        gain = (1.0 + 2j * damping * ratio) / (1.0 - ratio**2 + 2j * damping * ratio)
        driven: np.ndarray = np.fft.irfft(gain * self._spectrum[dof], self._length)[: self._samples]
        return driven
