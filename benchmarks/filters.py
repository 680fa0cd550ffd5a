"""A hysteretic structure beside the filters that are used for one: `make bench-filters`.

Three storeys, the lowest with Bouc-Wen hysteresis, a measured force on the roof, three accelerometers, 30 dB, 60 s at
100 Hz, simulated by scipy. Every stiffness, damper and number of the law is unknown. The program is told nothing of
them. The filters (extended, cubature, ensemble, particles; state and logarithms of the parameters together, as in
Chatzi and Smyth 2009) are told the sensors' noise as it is, and begin at values that are off by a third, with a
standard deviation of 0.4. What a sample adds to the parameters and to what their model leaves open was tuned for the
unscented one, with the truth, on the first record. Printed for each, medians over the seeds:

    k, c, law   errors of the parameters, %, the largest of each kind
    inside      share of all true values within the 90 % intervals, %
    lost        records of which a parameter ends up more than half of its value off
    s           of the processor
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from benchmarks.__main__ import counted
from benchmarks.trust.case import Case
from benchmarks.trust.families.nonlinear import bouc_wen
from benchmarks.trust.structures import Structure, noisy, simulated
from benchmarks.trust.waves import random_waves
from benchmarks.written import markdown, write
from pinn_cli.system.priors import HALF_WIDTH_90

STOREYS, RATE, SECONDS, DECIBEL = 3, 100.0, 60.0, 30.0
OFF, BELIEVED = 0.33, 0.4  # of the filters' first values: how far off, and how far they are said to be
STEPS = 2  # of Runge and Kutta from a sample to the next one
WALK = 1e-3  # of a logarithm of a parameter, from a sample to the next one
UNSAID = 1e-2  # of the model's acceleration over the rms one
ENSEMBLE, PARTICLES = 300, 3000
SHRINKS = 0.99  # of the particles' parameters towards their mean, from a sample to the next one (Liu and West 2001)
PAGE = Path(__file__).parents[1] / "docs" / "compared.md"

Array = np.ndarray


@dataclass(frozen=True)
class Model:
    """What the filters know.

    Attributes:
        mass: (n,), kg.
        names: Of the parameters: springs and dampers from the ground up, then the law's A, beta and gamma.
        force: On the roof at each sample, N.
        measured: Accelerations (time, n), m/s^2.
        noise: Of them (n,).
        first: Logarithms of the parameters that they begin at.
    """

    mass: Array
    names: tuple[str, ...]
    force: Array
    measured: Array
    noise: Array
    first: Array

    @property
    def states(self) -> int:
        """Displacements, velocities and the hysteretic force."""
        return 2 * len(self.mass) + 1

    def rate(self, x: Array, force: float) -> Array:
        """Of states and parameters (N, S): (N, S)."""
        n = len(self.mass)
        u, v, z = x[:, :n], x[:, n : 2 * n], x[:, 2 * n]
        values = np.exp(np.clip(x[:, self.states :], -60.0, 60.0))
        k, c, (A, beta, gamma) = values[:, :n], values[:, n : 2 * n], values[:, 2 * n :].T
        e, de = np.diff(u, axis=1, prepend=0.0), np.diff(v, axis=1, prepend=0.0)
        push = k * e + c * de
        push[:, 0] += z
        total = -push
        total[:, :-1] += push[:, 1:]
        total[:, -1] += force
        out = np.zeros_like(x)
        out[:, :n], out[:, n : 2 * n] = v, total / self.mass
        out[:, 2 * n] = A * de[:, 0] - beta * np.abs(de[:, 0]) * z - gamma * de[:, 0] * np.abs(z)
        return out

    def after(self, x: Array, i: int) -> Array:
        """The same (N, S) from sample i to the next one, the force on a line between them."""
        step = 1.0 / (RATE * STEPS)
        for j in range(STEPS):
            ends = [
                self.force[i] + (self.force[i + 1] - self.force[i]) * (j + part) / STEPS for part in (0.0, 0.5, 1.0)
            ]
            a = self.rate(x, ends[0])
            b = self.rate(x + 0.5 * step * a, ends[1])
            c = self.rate(x + 0.5 * step * b, ends[1])
            x = x + step / 6.0 * (a + 2.0 * b + 2.0 * c + self.rate(x + step * c, ends[2]))
        return x

    def felt(self, x: Array, i: int) -> Array:
        """Accelerations at sample i (N, n)."""
        n = len(self.mass)
        return self.rate(x, self.force[i])[:, n : 2 * n]

    @property
    def begins(self) -> tuple[Array, Array]:
        """Mean and covariance at rest."""
        size = self.measured.std() / RATE**2
        variance = np.full(self.states + len(self.names), BELIEVED**2)
        variance[: self.states] = size**2
        variance[2 * len(self.mass)] = (size * np.exp(self.first[0])) ** 2
        return np.concatenate([np.zeros(self.states), self.first]), np.diag(variance)

    @property
    def driven(self) -> Array:
        """(S,), variances that a sample adds."""
        n, out = len(self.mass), np.full(self.states + len(self.names), WALK**2)
        out[: self.states] = 0.0
        out[n : 2 * n] = (UNSAID * self.measured.std() / RATE) ** 2
        return out


def gaussian(model: Model, far: float) -> tuple[Array, Array]:
    """Last mean (S,) and covariance (S, S) of a filter whose Gaussian is its mean and two points along each axis.

    They lie so many deviations apart from it: the root of the number of axes is an unscented filter's (Arasaratnam and
    Haykin 2009), and so near that what is between them is straight an extended filter's.
    """
    mean, covariance = model.begins
    for i in range(len(model.force) - 1):
        points, weights = spread(mean, covariance, far)
        points = model.after(points, i)
        mean = weights @ points
        off = points - mean
        covariance = (weights * off.T) @ off + np.diag(model.driven)
        points, weights = spread(mean, covariance, far)
        shown = model.felt(points, i + 1)
        seen = weights @ shown
        off, moved = points - mean, shown - seen
        across = (weights * off.T) @ moved
        scatter = (weights * moved.T) @ moved + np.diag(model.noise**2)
        gain = np.linalg.solve(scatter, across.T).T
        mean = mean + gain @ (model.measured[i + 1] - seen)
        covariance = covariance - gain @ scatter @ gain.T
        covariance = (covariance + covariance.T) / 2.0
    return mean, covariance


def spread(mean: Array, covariance: Array, far: float) -> tuple[Array, Array]:
    """Points (2 S + 1, S) and weights."""
    values, vectors = np.linalg.eigh(covariance)
    root = far * vectors * np.sqrt(np.maximum(values, 0.0))
    weights = np.full(2 * len(mean) + 1, 0.5 / far**2)
    weights[0] = 1.0 - len(mean) / far**2
    return mean + np.concatenate([np.zeros((1, len(mean))), root.T, -root.T]), weights


def ensemble(model: Model, rng: np.random.Generator) -> tuple[Array, Array]:
    """Last mean and covariance of an ensemble filter with perturbed observations (Evensen 1994)."""
    mean, covariance = model.begins
    x = mean + rng.standard_normal((ENSEMBLE, len(mean))) * np.sqrt(np.diag(covariance))
    for i in range(len(model.force) - 1):
        x = model.after(x, i) + rng.standard_normal(x.shape) * np.sqrt(model.driven)
        shown = model.felt(x, i + 1)
        off, moved = x - x.mean(0), shown - shown.mean(0)
        scatter = moved.T @ moved / ENSEMBLE + np.diag(model.noise**2)
        seen = shown + rng.standard_normal(shown.shape) * model.noise
        x = x + (model.measured[i + 1] - seen) @ np.linalg.solve(scatter, moved.T @ off / ENSEMBLE)
    return x.mean(0), np.cov(x.T)


def particles(model: Model, rng: np.random.Generator) -> tuple[Array, Array]:
    """Those of a bootstrap filter whose parameters are drawn about shrunk ones (Liu and West 2001)."""
    mean, covariance = model.begins
    x = mean + rng.standard_normal((PARTICLES, len(mean))) * np.sqrt(np.diag(covariance))
    states, log_weight = model.states, np.zeros(PARTICLES)
    for i in range(len(model.force) - 1):
        x = model.after(x, i) + rng.standard_normal(x.shape) * np.sqrt(model.driven)
        off = (model.measured[i + 1] - model.felt(x, i + 1)) / model.noise
        log_weight = np.nan_to_num(log_weight - 0.5 * (off**2).sum(1), nan=-np.inf)
        weights = _normalised(log_weight)
        log_weight = np.log(np.maximum(weights, 1e-300))
        if 1.0 / (weights**2).sum() < 0.5 * PARTICLES:
            places = np.searchsorted(np.cumsum(weights), (np.arange(PARTICLES) + rng.random()) / PARTICLES)
            x = x[np.minimum(places, PARTICLES - 1)]
            about = x[:, states:].mean(0)
            spread = np.sqrt((1.0 - SHRINKS**2) * x[:, states:].var(0))
            x[:, states:] = SHRINKS * x[:, states:] + (1.0 - SHRINKS) * about
            x[:, states:] += rng.standard_normal(x[:, states:].shape) * spread
            log_weight = np.zeros(PARTICLES)
    weights = _normalised(log_weight)
    mean = weights @ x
    return mean, ((x - mean).T * weights) @ (x - mean)


def _normalised(log_weight: Array) -> Array:
    weights: Array = np.exp(log_weight - log_weight.max())
    return weights / weights.sum()


FILTERS: dict[str, Callable[[Model, np.random.Generator], tuple[Array, Array]]] = {
    "extended Kalman filter": lambda model, rng: gaussian(model, 1e-2),
    "unscented (cubature) Kalman filter": lambda model, rng: gaussian(model, np.sqrt(model.states + len(model.names))),
    "ensemble Kalman filter": ensemble,
    "particle filter": particles,
}


def drawn(seed: int) -> tuple[Case, Model]:
    """A structure and its record for the program, and for the filters."""
    rng, n = np.random.default_rng([seed, 120]), STOREYS
    mass = 1e4 * rng.uniform(0.8, 1.2, n)
    k = mass.mean() * (2.0 * np.pi * 2.0) ** 2 / 0.2 * rng.uniform(0.8, 1.2, n)
    structure = Structure.chain(mass, "storey_", k=k, c=2.0 * 0.02 * np.sqrt(k * mass))
    lowest, *others = structure.connections
    times = np.arange(0.0, SECONDS, 1.0 / RATE)
    waves = random_waves(rng, (0.2, 25.0), np.array([0.1 * 9.81 * mass.mean()]), 600, np.ones_like)
    dense = np.arange(0.0, SECONDS + 0.1, 1.0 / (20.0 * 25.0))
    unit, roof = CubicSpline(dense, waves(dense)[:, 0]), np.eye(n)[-1]
    M, C, K = np.diag(mass), structure.matrix("c"), structure.matrix("k")
    linear = waves.moves(M, C, K, roof[:, None], times)
    stretch, speed = (float(of[:, 0].std()) for of in (linear.displacement, linear.velocity))
    structure = replace(structure, connections=(bouc_wen(rng, lowest, stretch, speed), *others))
    motion = simulated(structure, lambda t: roof * unit(t), times, 25.0, method="LSODA")
    felt = np.stack([noisy(rng, motion.acceleration[:, i], DECIBEL) for i in range(n)], -1)
    table = {"t": times, "f": unit(times)} | {f"a{i + 1}": felt[:, i] for i in range(n)}
    settings, true = structure.unknown(force={structure.dofs[-1]: "f"}, acceleration=structure.columns("a"))
    names = tuple(f"{kind}_storey_{i + 1}" for kind in "kc" for i in range(n))
    names += tuple(f"{kind}_storey_1" for kind in ("A", "beta", "gamma"))
    noise = motion.acceleration.std(0) * 10.0 ** (-DECIBEL / 20.0)
    sign = rng.choice([-1.0, 1.0], len(names))
    first = np.log([true[name] for name in names]) + np.log1p(OFF) * sign
    model = Model(mass, names, table["f"], felt, noise, first)
    return Case("filters", seed, {"record.csv": pd.DataFrame(table)}, settings, motion.truth(true, range(n))), model


def by_program(case: Case) -> tuple[pd.DataFrame, float]:
    """Parameters with `estimate`, `lower` and `upper`, and seconds."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        case.write(folder)
        took = counted(["--config-dir", str(folder), f"experiment={case.name}", "figures=false"], folder / "run")
        table = pd.read_csv(folder / "run" / "parameters.csv").set_index("parameter")
    ends = {"lower_90": "lower", "upper_90": "upper"}
    return table.rename(columns=ends)[["estimate", *ends.values()]], took["cpu_s"]


def by_filter(model: Model, name: str, seed: int) -> tuple[pd.DataFrame, float]:
    """The same."""
    began = time.process_time()
    with np.errstate(all="ignore"):
        try:
            mean, covariance = FILTERS[name](model, np.random.default_rng(seed))
        except np.linalg.LinAlgError:  # it has diverged
            mean = np.full(model.states + len(model.names), np.nan)
            covariance = np.diag(mean)
    half = HALF_WIDTH_90 * np.sqrt(np.maximum(np.diag(covariance), 0.0))[model.states :]
    middle = mean[model.states :]
    ends = {"estimate": middle, "lower": middle - half, "upper": middle + half}
    return pd.DataFrame({key: np.exp(x) for key, x in ends.items()}, list(model.names)), time.process_time() - began


def row(found: tuple[pd.DataFrame, float], truth: dict[str, float], program: str, seed: int) -> dict[str, float | str]:
    """How near one estimate came."""
    table, seconds = found
    true = pd.Series(truth)
    table = table.loc[true.index]
    off = (100.0 * (table["estimate"] / true - 1.0).abs()).fillna(np.inf)
    inside = (table["lower"] <= true) & (true <= table["upper"])
    kinds = true.index.str.partition("_").get_level_values(0)
    worst = {of: float(off[kinds.isin(names)].max()) for of, names in
             {"k": ["k"], "c": ["c"], "law": ["A", "beta", "gamma"]}.items()}  # fmt: skip
    return {"program": program, "seed": seed, **worst, "inside": 100.0 * float(inside.mean()),
            "lost": float(off.max() > 50.0), "s": seconds}  # fmt: skip


def summary(table: pd.DataFrame) -> str:
    """Medians, and shares, as Markdown."""
    rows = []
    for program, part in table.groupby("program", sort=False):
        middle = part.median(numeric_only=True)
        errors = {f"{of}, %": "diverged" if np.isinf(middle[of]) else f"{middle[of]:.2g}" for of in ("k", "c", "law")}
        held, lost = f"{part['inside'].mean():.0f}", f"{int(part['lost'].sum())} of {len(part)}"
        rows.append(
            {"program": program, **errors, "90 % intervals hold, %": held, "lost": lost, "s": f"{middle['s']:.2g}"}
        )
    return markdown(pd.DataFrame(rows))


def main() -> None:
    """Run all, and print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.filters", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10, help="records")
    parser.add_argument("--write", action="store_true", help="the table goes to docs/compared.md")
    given = parser.parse_args()
    rows = []
    for seed in range(given.seeds):
        case, model = drawn(seed)
        estimates = {"pinn-run": by_program(case)} | {name: by_filter(model, name, seed) for name in FILTERS}
        for name, found in estimates.items():
            rows.append(row(found, case.truth.parameters, name, seed))
            print(*(x if isinstance(x, str) else f"{x:.3g}" for x in rows[-1].values()), flush=True)
    text = summary(pd.DataFrame(rows))
    print(text)
    if given.write:
        write(PAGE, "filters", text, "make bench-filters")


if __name__ == "__main__":
    main()
