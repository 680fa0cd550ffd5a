"""The probability of a record under a spline network and a chain, written out with dense matrices, in numpy alone."""

from collections.abc import Sequence

import numpy as np
from bayesian_problems import Example
from scipy.interpolate import BSpline

from pinn_cli.physics import hold_delay


class DenseModel:
    """Displacement and velocity of every DOF, the force residual, and their variances under an example's noise.

    The equation of motion holds on the average over every knot interval, with those at the ends divided until there
    are as many averages as features but two. What the features cannot follow of a measured force is its sensor's noise.
    Weights are (K, n); parameters are a vector in the order of the problem's uncertain ones.
    """

    def __init__(self, example: Example, s: float = 0.0) -> None:
        self.problem, self.noise = example.problem, example.trained.noise.records[0]
        record, network = self.problem.record, example.equations.network
        degree, width = network.degree, network.spacing
        knots = network.start + width * np.arange(-degree, network.intervals + degree + 1)
        spline = BSpline(knots, np.eye(network.count), degree)
        self.value, self.rate = spline(record.time), spline.derivative()(record.time)
        later = record.time + hold_delay(record)
        self.at_force = tuple(spline.derivative(order)(later) for order in range(3))
        self.record, self.shape = record, (network.count, record.ndof)
        self.basis = np.linalg.qr(self.at_force[0])[0]
        cell = np.clip(np.floor((later - network.start) / width).astype(int), 0, network.intervals - 1)
        self.averaging = averaging_matrix(cell, network.intervals, network.count - 2)
        self.forced = record.sensors("force")
        self.set_noise(s)
        self.values = {kind: value.numpy().copy() for kind, value in self.problem.structure.parameters.items()}

    def set_noise(self, s: float) -> None:
        """Let the force sensors' noise be exp(s) times that of the example."""
        self.sensor = (self.noise.force[self.forced] * np.exp(s)) ** 2
        self.variance = np.full(self.shape[1], self.noise.discrepancy**2)
        self.variance[self.forced] += self.sensor

    def unseen(self, residual: np.ndarray) -> np.ndarray:
        """What the features cannot follow of the force residual (N, n) of the measured forces; 0 elsewhere."""
        out = np.zeros_like(residual)
        measured = residual[:, self.forced]
        out[:, self.forced] = measured - self.basis @ (self.basis.T @ measured)
        return out

    def parameters(self, theta: Sequence[float]) -> dict[str, np.ndarray]:
        out = {kind: value.copy() for kind, value in self.values.items()}
        for parameter, value in zip(self.problem.uncertain, theta, strict=True):
            out[parameter.kind][parameter.index] = value
        return out

    def chi_square(self, weights: np.ndarray, theta: Sequence[float]) -> tuple[float, np.ndarray, np.ndarray]:
        """Weighted sum of squares of a chain with cubic springs, its gradient by the weights and by theta."""
        p = self.parameters(theta)
        total, by_weights = 0.0, np.zeros(self.shape)
        for name, features in (("displacement", self.value), ("velocity", self.rate)):
            residual = features @ weights - getattr(self.record, name)
            weighted = residual / self.noise.response[name] ** 2
            total += float(np.sum(residual * weighted))
            by_weights += 2.0 * features.T @ weighted
        u, v, a = (features @ weights for features in self.at_force)
        e, de = (np.diff(x, axis=1, prepend=0.0) for x in (u, v))
        kappa = p.get("kappa", np.zeros(self.shape[1]))
        carried = p["c"] * de + p["k"] * e + kappa * e**3
        residual = p["m"] * a + carried - np.append(carried[:, 1:], np.zeros((len(u), 1)), axis=1) - self.record.force
        seen = self.averaging.T @ (self.averaging @ residual)
        finer = np.zeros(self.shape[1])
        finer[self.forced] = 1.0 / self.sensor
        weighted = 2.0 * (seen / self.variance + self.unseen(residual) * finer)
        total += 0.5 * float(np.sum(residual * weighted))
        by_carried = np.diff(weighted, axis=1, prepend=0.0)
        by_e, by_de = by_carried * (p["k"] + 3.0 * kappa * e**2), by_carried * p["c"]
        by_u, by_v = (x - np.append(x[:, 1:], np.zeros((len(u), 1)), axis=1) for x in (by_e, by_de))
        value, rate, curvature = self.at_force
        by_weights += value.T @ by_u + rate.T @ by_v + curvature.T @ (p["m"] * weighted)
        by = {"m": a, "c": de, "k": e, "kappa": e**3}
        own = {"m": weighted}
        by_theta = [
            float(np.sum(own.get(q.kind, by_carried)[:, q.index] * by[q.kind][:, q.index]))
            for q in self.problem.uncertain
        ]
        return total, by_weights, np.array(by_theta)

    def squares_of_force(self, weights: np.ndarray, theta: Sequence[float]) -> tuple[float, float]:
        """Sum of squares of the averages of the measured forces' residuals, and of what no feature follows, N^2."""
        residual = (self.required(weights, theta) - self.record.force) * self.forced
        return float(np.sum((self.averaging @ residual) ** 2)), float(np.sum(self.unseen(residual) ** 2))

    def required(self, weights: np.ndarray, theta: Sequence[float]) -> np.ndarray:
        """(N, n), the force that a motion takes."""
        p = self.parameters(theta)
        u, v, a = (features @ weights for features in self.at_force)
        e, de = (np.diff(x, axis=1, prepend=0.0) for x in (u, v))
        carried = p["c"] * de + p["k"] * e + p.get("kappa", 0.0) * e**3
        return p["m"] * a + carried - np.append(carried[:, 1:], np.zeros((len(u), 1)), axis=1)

    def marginal(self, theta: Sequence[float]) -> tuple[float, float]:
        """Of a linear chain: the least sum of squares of all weights, and the log determinant of its Hessian."""
        hessian, right, constant = self._quadratic(theta)
        factor = np.linalg.cholesky(hessian)
        half = np.linalg.solve(factor, right)
        return constant - float(half @ half), 2.0 * float(np.log(np.diag(factor)).sum())

    def log_likelihood(self, theta: Sequence[float], s: float) -> float:
        """Of a linear chain, at force noise exp(s): of every sample and repeat, up to a constant in theta and s."""
        self.set_noise(s)
        least, determinant = self.marginal(theta)
        forced, repeats = self.forced, self.record.repeats
        count, samples, averages = self.shape[0], len(self.record.time), len(self.averaging)
        unseen = np.sum(self.unseen(self.force(theta) - self.record.force)[:, forced] ** 2, axis=0)
        least += float(np.sum(unseen / self.sensor))
        logarithms = averages * np.log(self.variance).sum() + 2.0 * (samples - count) * forced.sum() * s
        if repeats is not None:
            logarithms += (repeats.square["force"][forced] / (repeats.count * self.sensor)).sum()
            logarithms += 2.0 * repeats.freedom * forced.sum() * s
        return -0.5 * (least + determinant + float(logarithms))

    def force(self, theta: Sequence[float]) -> np.ndarray:
        """(N, n), what the most probable motion of a linear chain takes with these parameters."""
        hessian, right, _ = self._quadratic(theta)
        return self.required(np.linalg.solve(hessian, right).reshape(self.shape[1], -1).T, theta)

    def _quadratic(self, theta: Sequence[float]) -> tuple[np.ndarray, np.ndarray, float]:
        """Chi^2 = w^T H w - 2 g^T w + constant, w (n K,) DOF by DOF."""
        p, (count, n) = self.parameters(theta), self.shape
        below = np.eye(n) - np.eye(n, k=-1)  # displacements to elongations
        value, rate, curvature = self.at_force
        structure = np.kron(np.diag(p["m"]), curvature)
        for kind, features in (("c", rate), ("k", value)):
            structure += np.kron(below.T @ np.diag(p[kind]) @ below, features)
        structure = np.kron(np.eye(n), self.averaging) @ structure
        groups = [(structure, self.averaging @ self.record.force, np.sqrt(self.variance))]
        for name, features in (("displacement", self.value), ("velocity", self.rate)):
            groups.append((np.kron(np.eye(n), features), getattr(self.record, name), self.noise.response[name]))
        hessian, right, constant = np.zeros((n * count, n * count)), np.zeros(n * count), 0.0
        for matrix, measured, sigma in groups:
            weight = np.repeat(1.0 / sigma**2, len(measured))
            hessian += matrix.T @ (matrix * weight[:, None])
            right += matrix.T @ (weight * measured.T.ravel())
            constant += float(np.sum(weight * measured.T.ravel() ** 2))
        return hessian, right, constant


def averaging_matrix(cell: np.ndarray, intervals: int, wanted: int) -> np.ndarray:
    """(wanted, N): sums over the samples of an interval, or of a part of one, over the root of their number.

    Args:
        cell: (N,), the interval of every sample, none of them empty.
        intervals: In all.
        wanted: Rows; intervals are divided into three at most, alternately from the beginning and from the end.
    """
    points = np.bincount(cell, minlength=intervals)
    pieces, lacking = np.ones(intervals, dtype=int), wanted - intervals
    for order, share in ((range(intervals), (lacking + 1) // 2), (reversed(range(intervals)), lacking // 2)):
        left = share
        for group in order:
            more = min(left, min(points[group], 3) - pieces[group])
            pieces[group], left = pieces[group] + more, left - more
    rows = []
    for group in range(intervals):
        samples = np.flatnonzero(cell == group)
        piece = np.arange(len(samples)) * pieces[group] // len(samples)
        for part in range(pieces[group]):
            row = np.zeros(len(cell))
            row[samples[piece == part]] = 1.0 / np.sqrt(np.sum(piece == part))
            rows.append(row)
    return np.array(rows)
