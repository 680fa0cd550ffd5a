"""Other estimators of the same parameters: an output-error fit, a Kalman filter for state and parameters, and modes.

The first two are told more than the program: that the structure is at rest when the record begins, and how large the
noise of every channel is. Unknown stiffnesses may be off by a decade in common. So both begin at the common factor with
which the spectra of a simulation come nearest to those of the sensors.
"""

from __future__ import annotations

import time

import numpy as np
import pandas as pd
from scipy.interpolate import make_interp_spline
from scipy.linalg import expm
from scipy.signal import welch

from benchmarks.nearly_right.output_error import SMALL, fitted
from benchmarks.trust.ambient import updated
from benchmarks.trust.case import Case
from benchmarks.trust.told import Samples, Told

FIRST_PERIODS = 4.0  # of the lowest mode: the shortest fit
FACTORS = np.geomspace(0.08, 12.5, 23)  # common ones of the unknown parameters, at the beginning
PIECES, CLEAR = 8, 10.0  # of a record, for its spectra; times its noise is what counts of them
SPREAD = 0.4  # standard deviation of a logarithm where a pass of the filter begins
PASSES, SETTLED = 8, 1e-3  # of the filter through the record; change of the logarithms after which it ends
MOVED = 1e-3  # change of a logarithm after which the filter discretises anew
DEGREE = 5  # of the spline that the input is between the samples


def begun(told: Told, seen: Samples) -> np.ndarray:
    """The believed values of what is unknown, times the common factor that suits the sensors' spectra best, (p,)."""
    tried = FACTORS[:, None] * told.guess
    states = told.states(tried, np.zeros((len(tried), 2 * told.ndof)), seen.inputs, seen.dt)
    length = max(len(seen.sensors) // PIECES, 8)

    def spectra(of: np.ndarray) -> np.ndarray:
        found: np.ndarray = welch(of, nperseg=length, axis=-2)[1][..., 1:, :]
        return found

    noise, measured = 2.0 * told.noise**2, spectra(seen.sensors)  # white noise has a one-sided spectrum
    missed = np.log((spectra(told.outputs(tried, states, seen.inputs)) + noise) / measured)
    best: np.ndarray = tried[np.argmin(np.mean(missed**2, axis=(1, 2), where=measured > CLEAR * noise))]
    return best


def output_error(told: Told, seen: Samples) -> np.ndarray:
    """Parameters with which a simulation comes nearest to the sensors, (p,)."""
    start = begun(told, seen)
    lowest = np.abs(np.linalg.eigvals(told.matrix(start))).min() / (2.0 * np.pi)
    first = round(FIRST_PERIODS / lowest / seen.dt)
    return fitted(told, start, seen.inputs, seen.sensors, seen.dt, first, told.noise)[0]


def kalman_filter(told: Told, seen: Samples) -> np.ndarray:
    """Parameters of a joint extended Kalman filter that passes through the record until they stay, (p,).

    Each pass begins at rest, with what the last one found (Hoshiya and Saito 1984).
    """
    logarithms = np.log(begun(told, seen))
    for _ in range(PASSES):
        before, logarithms = logarithms, _passed(told, seen, logarithms)
        if np.abs(logarithms - before).max() < SETTLED:
            break
    return np.exp(logarithms)


def _passed(told: Told, seen: Samples, logarithms: np.ndarray) -> np.ndarray:
    """Logarithms of the parameters after the filter's way through the record. Its states are (logarithms, u, u')."""
    p, states, inputs = len(logarithms), 2 * told.ndof, len(told.inputs)
    spline, samples = (
        make_interp_spline(np.arange(len(seen.inputs)), seen.inputs, k=DEGREE),
        np.arange(len(seen.inputs)),
    )
    acting = np.hstack([spline.derivative(j)(samples) for j in range(DEGREE + 1)])
    push_noise = np.diag([each.noise**2 for each in told.inputs])
    z, P, F = np.append(logarithms, np.zeros(states)), np.zeros((p + states, p + states)), np.eye(p + states)
    P[:p, :p] = SPREAD**2 * np.eye(p)
    at = np.full(p, np.inf)
    for k, shown in enumerate(seen.sensors):
        if np.abs(z[:p] - at).max() > MOVED:
            at = z[:p].copy()
            moves, shows = _linearised(told, at, seen.dt)
            (C, D), (A, B) = (np.split(of[0][:, : states + inputs], [states], axis=1) for of in (shows, moves))
            noise, disturbed = np.diag(told.noise**2) + D @ push_noise @ D.T, B @ push_noise @ B.T
        now, off = np.append(z[p:], acting[k, :inputs]), z[:p] - at
        H = np.hstack([(shows[1:] @ now).T, C])
        gain = np.linalg.solve(H @ P @ H.T + noise, H @ P).T
        z = z + gain @ (shown - (shows[0] + np.tensordot(off, shows[1:], 1)) @ now)
        P = P - gain @ (H @ P)
        now, off = np.append(z[p:], acting[k]), z[:p] - at
        F[p:, :p], F[p:, p:] = (moves[1:] @ now).T, A
        z[p:] = (moves[0] + np.tensordot(off, moves[1:], 1)) @ now
        P = F @ P @ F.T
        P[p:, p:] += disturbed
        P = 0.5 * (P + P.T)
        if not np.isfinite(z).all():
            raise FloatingPointError("the filter diverged")
    return z[:p]


def _linearised(told: Told, logarithms: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Motion over a sample and what is seen: values and derivatives by the logarithms.

    Matrices (1 + p, 2 n, 2 n + 6 inputs) and (1 + p, sensors, 2 n + inputs). They are multiplied with the states, then
    the inputs and, for the motion, the derivatives of the inputs by the number of the sample.
    """
    p, states, inputs = len(logarithms), 2 * told.ndof, len(told.inputs)
    steps, size = SMALL * np.eye(p), states + (DEGREE + 1) * inputs
    found = []
    for each in np.exp([logarithms, *(logarithms + steps), *(logarithms - steps)]):
        A, whole = told.matrix(each), np.zeros((size, size))
        whole[:states, :states], whole[:states, states : states + inputs] = A * dt, told.push * dt
        whole[states:, states:] = np.eye(size - states, k=inputs)  # each derivative is the rate of the one before
        found.append((expm(whole)[:states], np.hstack(told.observed(A))))
    moves, shows = (np.stack(of) for of in zip(*found, strict=True))
    derived = [(of[1 : 1 + p] - of[1 + p :]) / (2.0 * SMALL) for of in (moves, shows)]
    return np.concatenate([moves[:1], derived[0]]), np.concatenate([shows[:1], derived[1]])


MEASURED_INPUTS = {"output error": output_error, "Kalman filter": kalman_filter}
NOTHING_MEASURED = {"subspace modes, updated model": updated}


def compared(case: Case) -> pd.DataFrame:
    """Columns peer, parameter, estimate and seconds (of the processor, for all of them); NaN where a peer failed.

    No rows where peers cannot do the task.
    """
    columns = ["peer", "parameter", "estimate", "seconds"]
    told = case.peer
    if not isinstance(told, Told):
        return pd.DataFrame(columns=columns)
    rows = []
    for peer, estimated in (MEASURED_INPUTS if told.inputs else NOTHING_MEASURED).items():
        began = time.process_time()
        try:
            with np.errstate(all="ignore"):
                found = estimated(told, Samples.of(told, case.records[told.record]))
        except (np.linalg.LinAlgError, ValueError, FloatingPointError):  # it diverged
            found = np.full(len(told.unknown), np.nan)
        seconds = time.process_time() - began
        rows += [[peer, name, value, seconds] for name, value in zip(told.unknown, found.tolist(), strict=True)]
    return pd.DataFrame(rows, columns=columns)
