"""Linear Gaussian time series with shared disturbances and regression coefficients: exact filter and smoother.

Step k takes a state and a disturbance to an observation and to the next state,

    [y_k; x_k+1] = c_k + T_k x_k + H_k e_k + B_k b + noise_k,   e_k ~ N(0, diag(q)),   noise_k ~ N(0, W),
    x_0 = A_0 b,

with coefficients b that are the same at all times. A disturbance that both moves the state and shows in a sensor
correlates process and measurement noise; so written, there is nothing special about that.

The filter conditions the joint Gaussian of (y_k, x_k+1) on y_k (Sarkka 2013, lemma A.2 and theorem 4.2, one step
later). Means are carried as linear functions of b, which then is a regression on the innovations (Rosenberg 1973; de
Jong 1991). As constant states the coefficients would double the matrices; and an unknown start, which is a coefficient
too, would enter as a huge P_0 that eats the digits of everything after it. The backward pass is that of de Jong (1989):
Rauch, Tung and Striebel's smoother without the inverse of a predicted covariance, which little noise leaves singular.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import dposv


@dataclass(frozen=True, eq=False)
class LinearGaussian:
    """N steps with s states, d disturbances, m observations and p coefficients; float64 throughout.

    Attributes:
        observed: (N, m), y_k.
        offset: (N, m + s), c_k.
        state: (N, m + s, s), T_k; the first m rows make the observation, the others the next state.
        disturbance: (N, m + s, d), H_k.
        coefficient: (N, m + s, p), B_k.
        disturbance_variance: (d,), q.
        noise: (m + s, m + s), W.
        initial: (s, p), A_0.
    """

    observed: np.ndarray
    offset: np.ndarray
    state: np.ndarray
    disturbance: np.ndarray
    coefficient: np.ndarray
    disturbance_variance: np.ndarray
    noise: np.ndarray
    initial: np.ndarray

    @cached_property
    def step_covariance(self) -> np.ndarray:
        """(N, m + s, m + s), of observation and next state of each step for a known state: disturbance and noise."""
        root = self.disturbance * np.sqrt(self.disturbance_variance)
        return root @ root.transpose(0, 2, 1) + self.noise

    def filter(self) -> Filtered:
        """Predictions and innovations of every step, as functions of the coefficients.

        Raises:
            FloatingPointError: An innovation has no positive definite covariance.
        """
        m = self.observed.shape[1]
        covariance, spread, gain = self._covariances()
        closed = self.state[:, m:] - gain @ self.state[:, :m]
        seen = (self.observed - self.offset[:, :m])[:, :, None]
        columns = np.concatenate((seen, -self.coefficient[:, :m]), axis=2)
        drive = np.concatenate((self.offset[:, m:, None], self.coefficient[:, m:]), axis=2)
        start = np.pad(self.initial, ((0, 0), (1, 0)))
        mean = driven(closed, start, gain @ columns + drive)
        innovation = columns - self.state[:, :m] @ mean
        return Filtered(self, covariance, mean, innovation, spread, gain, closed)

    def _covariances(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of the predicted states (N, s, s) and of the innovations (N, m, m), and gains (N, s, m)."""
        samples, m = self.observed.shape
        s = len(self.initial)
        joints = self.step_covariance.copy()
        covariance, solved = np.zeros((samples + 1, s, s)), []
        for k, (step, joint, before, after) in enumerate(
            zip(self.state, joints, covariance[:-1], covariance[1:], strict=True)
        ):
            joint += step @ before @ step.T  # noqa: PLW2901 (in place: what was added noise is the whole now)
            shared = joint[m:, :m]
            _, by_spread, failed = dposv(joint[:m, :m], shared.T)
            if failed:
                raise FloatingPointError(f"the innovation at sample {k} has no positive definite covariance")
            unseen = joint[m:, m:] - shared @ by_spread
            # Observations damp errors of a covariance only where it is symmetric: the skew part of the rounding would
            # grow as the model itself does, without bound under negative damping, which a wrong parameter may be.
            np.multiply(unseen + unseen.T, 0.5, out=after)
            solved.append(by_spread)
        gain = np.stack(solved).transpose(0, 2, 1)
        return covariance[:-1], joints[:, :m, :m], gain


def driven(closed: np.ndarray, initial: np.ndarray, drive: np.ndarray) -> np.ndarray:
    """(N, s, c), what begins as (s, c) and goes through (N, s, s) from step to step, with (N, s, c) added at each."""
    mean = np.empty((len(drive) + 1, *initial.shape))
    mean[0], mean[1:] = initial, drive
    for through, before, after in zip(closed, mean[:-1], mean[1:], strict=True):
        after += through @ before  # noqa: PLW2901 (in place: what drives the mean becomes the mean)
    return mean[:-1]


@dataclass(frozen=True, eq=False)
class Filtered:
    """Forward pass of a :class:`LinearGaussian`.

    Attributes:
        model: What was filtered.
        covariance: (N, s, s), of each state given all earlier observations and the coefficients.
        mean: (N, s, 1 + p), its mean: at coefficients zero, and by coefficient.
        innovation: (N, m, 1 + p), observations minus their predictions, likewise.
        spread: (N, m, m), covariance of the innovations.
        gain: (N, s, m), from innovation to the next predicted state.
        closed: (N, s, s), from a state to the next, innovation held.
    """

    model: LinearGaussian
    covariance: np.ndarray
    mean: np.ndarray
    innovation: np.ndarray
    spread: np.ndarray
    gain: np.ndarray
    closed: np.ndarray

    @cached_property
    def weighted(self) -> np.ndarray:
        """(N, m, 1 + p), innovations divided by their covariance."""
        return np.linalg.solve(self.spread, self.innovation)

    def smooth(self, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Smoothed states (N, s) and disturbances (N, d) at given coefficients (p,)."""
        columns = np.concatenate(([1.0], coefficients))
        states, disturbances = self._smoothed((self.mean @ columns)[..., None], (self.weighted @ columns)[..., None])
        return states[:, :, 0], disturbances[:, :, 0]

    def posterior(self) -> tuple[np.ndarray, np.ndarray]:
        """What all observations leave open about state and disturbance together.

        Their covariance at every step for known coefficients (N, s + d, s + d), and what each coefficient does to their
        mean (N, s + d, p).
        """
        s, m = self.mean.shape[1], self.innovation.shape[1]
        columns = np.concatenate(self._smoothed(self.mean[..., 1:], self.weighted[..., 1:]), axis=1)
        prior = np.zeros((len(columns), columns.shape[1], columns.shape[1]))
        prior[:, :s, :s] = self.covariance
        diagonal = np.arange(s, columns.shape[1])
        prior[:, diagonal, diagonal] = self.model.disturbance_variance
        of_innovation, push = self._noise_rows
        seen = np.concatenate((self.model.state[:, :m], of_innovation[..., m + s :]), axis=2)
        gone = np.concatenate((self.closed, push[..., m + s :]), axis=2)
        information = seen.transpose(0, 2, 1) @ np.linalg.solve(self.spread, seen)
        information += gone.transpose(0, 2, 1) @ self._later_information @ gone
        return prior - prior @ information @ prior, columns

    def information_on_noise(self, coefficients: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the noise of every sensor, state and disturbance (N, m + s + d): what is found, and the information.

        The derivative of the log probability of the observations by a variance is half of the squares less the
        information (Koopman and Shephard 1992), with the squares of the noise found over the variance squared. The
        information is what is left to find it by: the number of values that neither motion nor coefficients have taken
        up, over the variance. The noise found is over its variance, too. The coefficients found are (p,), their
        covariance (p, p).
        """
        of_innovation, push = self._noise_rows
        _, later = self._scores(self.weighted)
        scores = of_innovation.transpose(0, 2, 1) @ self.weighted + push.transpose(0, 2, 1) @ later
        information = np.sum(of_innovation * np.linalg.solve(self.spread, of_innovation), axis=1)
        information += np.sum(push * (self._later_information @ push), axis=1)
        information -= np.sum((scores[..., 1:] @ np.linalg.cholesky(covariance)) ** 2, axis=2)
        return scores @ np.concatenate(([1.0], coefficients)), information

    def products(self, noise: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """(L, L), products of L histories of noise (N, m + s + d, L) over the covariance of the observations.

        That of the coefficients (p, p) is included. Half of them are the average of expected and observed information
        on variances (Gilmour, Thompson and Cullis 1995), where the noise is what is found of each, times its variance.
        """
        of_innovation, push = self._noise_rows
        missed = driven(self.closed, np.zeros((self.mean.shape[1], noise.shape[2])), push @ noise)
        innovation = of_innovation @ noise + self.model.state[:, : self.innovation.shape[1]] @ missed
        weighted = np.linalg.solve(self.spread, innovation)
        gram = np.einsum("kmi,kmj->ij", innovation, weighted)
        shared = np.einsum("kmi,kmp->ip", weighted, self.innovation[..., 1:])
        return gram - shared @ covariance @ shared.T

    @property
    def _noise_rows(self) -> tuple[np.ndarray, np.ndarray]:
        """What noise and disturbances do to the innovation (N, m, m + s + d) and, that held, to the next state."""
        m, size = self.innovation.shape[1], len(self.model.noise)
        identity = np.broadcast_to(np.eye(size), (len(self.mean), size, size))
        rows = np.concatenate((identity, self.model.disturbance), axis=2)
        return rows[:, :m], rows[:, m:] - self.gain @ rows[:, :m]

    def _smoothed(self, mean: np.ndarray, weighted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Smoothed states (N, s, c) and disturbances (N, d, c), column by column."""
        score, later = self._scores(weighted)
        m = self.innovation.shape[1]
        of_innovation, push = (rows[..., m + mean.shape[1] :].transpose(0, 2, 1) for rows in self._noise_rows)
        disturbances = self.model.disturbance_variance[:, None] * (of_innovation @ weighted + push @ later)
        return mean + self.covariance @ score, disturbances

    def _scores(self, weighted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What this and later observations say about a state (N, s, c), and about the next one (N, s, c)."""
        observe = self.model.state[:, : self.innovation.shape[1]]
        score = observe.transpose(0, 2, 1) @ weighted
        later = np.zeros_like(score)
        for back, now, before, after in zip(self.closed[::-1], score[::-1], later[-2::-1], later[::-1], strict=False):
            np.add(back.T @ after, now, out=before)
        return score + self.closed.transpose(0, 2, 1) @ later, later

    @cached_property
    def _later_information(self) -> np.ndarray:
        """(N, s, s), what later observations tell about the state after each step."""
        observe = self.model.state[:, : self.innovation.shape[1]]
        information = observe.transpose(0, 2, 1) @ np.linalg.solve(self.spread, observe)
        later = np.zeros_like(information)
        for through, now, before, after in zip(
            self.closed[::-1], information[::-1], later[-2::-1], later[::-1], strict=False
        ):
            np.add(through.T @ after @ through, now, out=before)
        return later
