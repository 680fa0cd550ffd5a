"""Time of one epoch of the paper's training, ours against a plain one: `make bench-epochs`.

Both steps have the same network, losses and weights; the plain one takes one reverse pass per output (plain_step.py)
and has torch's Adam as it comes. Before anything is timed, their losses and gradients must agree. Then they take
turns, so that whatever else the machine does meets both alike, and the medians count. The fraction is that of the
highest rate of matrix products seen, of the fastest step, and counts the step's products alone.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import pandas as pd
import torch

from benchmarks.plain_step import PlainNetwork
from pinn_cli.cli.composing import compose_config
from pinn_cli.cli.config import RunConfig
from pinn_cli.cli.prepare import prepare_problem
from pinn_cli.training.estimate import RunContext
from pinn_cli.training.gradient.adam import Adam
from pinn_cli.training.gradient.losses import Objective

CASES = {
    "sparse_recovery_6": ["experiment=paper_training", "system.ndof=6"],
    "sparse_recovery_20": ["experiment=paper_training", "system.ndof=20"],
    "state_parameter_5": ["experiment=paper_training_state_parameter", "system.ndof=5"],
}
# Relative; float32 and two orders of summation.
AGREEMENT = 1e-5
LARGE = 2048


def objective(overrides: list[str]) -> tuple[Objective, Adam]:
    """The problem of a configuration, as its training sees it."""
    config = RunConfig.read(compose_config(overrides))
    training = config.training
    assert isinstance(training, Adam)
    return training.objective(prepare_problem(config).problem.alone, config.network, RunContext()), training


def our_step(given: Objective, training: Adam) -> Callable[[], None]:
    """The program's own."""
    optimiser = training.optimiser(given)

    def step() -> None:
        optimiser.step(given, given())

    return step


def plain_step(given: Objective, training: Adam) -> Callable[[], None]:
    """The plain one, on the objective's network and parameters."""
    groups = [
        {"params": list(given.network.parameters()), "weight_decay": training.weight_decay},
        {"params": list(given.parameters.parameters()), "lr": training.parameter_learning_rate},
    ]
    optimiser = torch.optim.Adam(groups, lr=training.learning_rate, betas=training.betas)

    def step() -> None:
        optimiser.zero_grad()
        plain_loss(given).backward()
        optimiser.step()
        given.parameters.respect_bounds()

    return step


def plain_loss(given: Objective) -> torch.Tensor:
    """The weighted loss by one reverse pass per output."""
    weights = given.term_weights()
    terms = given.losses.terms(PlainNetwork(given.network), given.parameters)
    return sum(weights[name] * term for name, term in terms.items())


def check_agreement(given: Objective) -> None:
    """Losses and gradients of both steps are the same."""
    variables = given.variables
    losses = (given().loss, plain_loss(given))
    ours, plain = (torch.cat([g.flatten() for g in torch.autograd.grad(x, variables)]) for x in losses)
    for mine, theirs in ((losses[0].detach(), losses[1].detach()), (ours, plain)):
        assert float((mine - theirs).norm() / theirs.norm()) < AGREEMENT, "the two steps differ"


def product_flops(given: Objective) -> float:
    """Floating-point operations of the matrix products of one step of ours.

    A layer multiplies the value and its rate by its weights on the way forward, and on the way back by their transpose
    (not in the first layer) and by the gradients, for the weights' own.
    """
    target = given.losses.target
    points = len(target.physics_time) * (1 if given.losses.simultaneous else 2)
    orders = 2
    sizes = [weight.numel() for weight in given.network.weights]
    return 2.0 * points * orders * (3.0 * sum(sizes) - sizes[0])


def seconds(work: Callable[[], object], repetitions: int) -> float:
    """Of one call, the mean over repetitions."""
    start = time.perf_counter()
    for _ in range(repetitions):
        work()
    return (time.perf_counter() - start) / repetitions


def product_rate(rows: int, inner: int, columns: int) -> float:
    """Floating-point operations per second of a float32 matrix product, the best of many."""
    a, b = torch.randn(rows, inner), torch.randn(inner, columns)
    torch.mm(a, b)
    return 2.0 * rows * inner * columns / min(seconds(lambda: torch.mm(a, b), 2) for _ in range(15))


def measure(name: str, rounds: int) -> dict[str, float | str]:
    """One case: median seconds of both steps, taking turns, and the rate of ours."""
    given, training = objective(CASES[name])
    check_agreement(given)
    steps = {"ours": our_step(given, training), "plain": plain_step(given, training)}
    for step in steps.values():
        step()
    taken: dict[str, list[float]] = {kind: [] for kind in steps}
    for _ in range(rounds):
        taken["ours"].append(seconds(steps["ours"], 5))
        taken["plain"].append(seconds(steps["plain"], 1))
    ours, plain, best = median(taken["ours"]), median(taken["plain"]), min(taken["ours"])
    width = given.network.weights[1].shape[0]
    points = len(given.losses.target.physics_time)
    return {
        "case": name,
        "points": points,
        "plain_ms": 1e3 * plain,
        "ours_ms": 1e3 * ours,
        "faster": plain / ours,
        "best_ms": 1e3 * best,
        "gflops": 1e-9 * product_flops(given) / best,
        "layer_gflops": 1e-9 * product_rate(points, width, width),
        "large_gflops": 1e-9 * product_rate(LARGE, LARGE, LARGE),
    }


def main() -> None:
    """Measure, print and write ``outputs/bench/epochs.csv``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=15)
    settings = parser.parse_args()
    torch.set_num_threads(settings.threads)
    table = pd.DataFrame([measure(name, settings.rounds) for name in CASES])
    table.insert(1, "threads", settings.threads)
    # Whoever else works on this machine slows some of the measurements down and speeds none up.
    table["fraction"] = table["gflops"] / table[["layer_gflops", "large_gflops"]].to_numpy().max()
    folder = Path("outputs/bench")
    folder.mkdir(parents=True, exist_ok=True)
    table.to_csv(folder / "epochs.csv", index=False)
    print(table.round(2).to_string(index=False))
    print(folder / "epochs.csv")


if __name__ == "__main__":
    main()
