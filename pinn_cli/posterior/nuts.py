"""One chain of Pyro's NUTS over a whitened density, and the file that keeps it once it is finished."""

from __future__ import annotations

import hashlib
import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pyro.infer.mcmc import MCMC, NUTS, BlockMassMatrix
from torch import Tensor

from pinn_cli.posterior.target import Target
from pinn_cli.runs.identity import package_version
from pinn_cli.runs.reading import check_layout, read_arrays, stamp
from pinn_cli.runs.writing import replacing
from pinn_cli.settings.errors import DivergenceError, InputError

SITE, MAX_TREE_DEPTH = "q", 10
# Width of the starts over that of the posterior: R-hat compares chains, which tells something if they began apart.
OVERDISPERSION = 2.0
CHAINS_FOLDER, FORMAT = "chains", 1
# Whose versions decide which numbers are drawn.
DRAWN_WITH = ("pinn-cli", "pyro-ppl", "torch", "numpy")
# Places at which a likelihood is asked what it says, to know it again.
PROBES = 4
# Names and types of what is noted about a transition; the names are ArviZ's.
STATISTICS: dict[str, type] = {"lp": float, "step_size": float, "n_steps": int, "tree_depth": int, "diverging": bool}

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class NutsSettings:
    """How long, and how carefully: those of :class:`pinn_cli.posterior.marginal.Marginal`."""

    warmup: int
    draws: int
    target_accept: float


@dataclass(frozen=True, eq=False)
class ChainDraws:
    """One finished chain.

    Attributes:
        q: (draws, size), whitened coordinates.
        statistics: ``STATISTICS``' names to (draws,). A tree's depth counts doublings, of which the last may have been
            cut short.
        seconds: That it took, warmup included.
    """

    q: np.ndarray
    statistics: dict[str, np.ndarray]
    seconds: float


def sample_chain(
    density: Target, seed: int, chain: int, settings: NutsSettings, after_iteration: Callable[[], Any] = lambda: None
) -> ChainDraws:
    """Draws of one chain: the same for the same (density, seed, chain, settings), whatever ran before.

    Masses are one: on whitened coordinates, of unit width along every axis, learned ones give as many effective draws,
    at two thirds of the speed. Torch's generator is left as it was. Something may be called after each of the warmup +
    draws iterations.

    Raises:
        DivergenceError: The density is finite nowhere near its centre.
    """
    started, steps = time.perf_counter(), 0
    start, torch_seed = _start(density, np.random.SeedSequence([seed, chain]))

    def potential(sites: dict[str, Tensor]) -> Tensor:
        nonlocal steps
        steps += 1
        q = sites[SITE]
        value, slope = density.potential(q.detach().numpy())
        return value + torch.from_numpy(slope) @ (q - q.detach())  # which automatic differentiation differentiates

    kernel = NUTS(
        potential_fn=potential,
        adapt_mass_matrix=False,
        target_accept_prob=settings.target_accept,
        max_tree_depth=MAX_TREE_DEPTH,
    )
    kernel.mass_matrix_adapter = _UnitMasses()
    rows: list[tuple[Any, ...]] = []

    def after(kernel: Any, position: dict[str, Tensor], stage: str, iteration: int) -> None:
        nonlocal steps
        if stage == "Sample":
            log_density = -density.potential(position[SITE].numpy())[0]
            diverged = iteration in kernel.diagnostics()["divergences"][-1:]
            rows.append((log_density, kernel.step_size, steps, steps.bit_length(), diverged))
        steps = 0
        after_iteration()

    sampler = MCMC(
        kernel,
        num_samples=settings.draws,
        warmup_steps=settings.warmup,
        initial_params={SITE: torch.from_numpy(start)},
        hook_fn=after,
        disable_progbar=True,
    )
    with torch.random.fork_rng(devices=[]), np.errstate(all="ignore"):
        # Not torch.manual_seed, which reseeds the generators of GPUs too.
        torch.default_generator.manual_seed(torch_seed)
        sampler.run()
    columns = zip(STATISTICS.items(), zip(*rows, strict=True), strict=True)
    statistics: dict[str, np.ndarray] = {name: np.array(values, dtype=kind) for (name, kind), values in columns}
    return ChainDraws(sampler.get_samples()[SITE].numpy(), statistics, time.perf_counter() - started)


class _UnitMasses(BlockMassMatrix):
    """Masses of one for Pyro's kernel, without its products with them, which take a quarter of the time."""

    def kinetic_grad(self, r: dict[str, Tensor]) -> dict[str, Tensor]:
        """Velocity of a momentum."""
        return r

    def scale(self, r_unscaled: dict[tuple[str], Tensor], r_prototype: dict[str, Tensor]) -> dict[str, Tensor]:
        """Momentum of standard normal numbers."""
        return {SITE: r_unscaled[SITE,]}

    def unscale(self, r: dict[str, Tensor]) -> dict[tuple[str], Tensor]:
        """Standard normal numbers of a momentum."""
        return {(SITE,): r[SITE]}


def _start(density: Target, sequence: np.random.SeedSequence) -> tuple[np.ndarray, int]:
    """An overdispersed start (size,) where the density is finite, and the seed of what follows."""
    for_start, for_torch = sequence.spawn(2)
    away = OVERDISPERSION * np.random.default_rng(for_start).standard_normal(density.size)
    torch_seed = int(for_torch.generate_state(1, np.uint64)[0] >> np.uint64(1))
    with np.errstate(all="ignore"):
        for _ in range(60):
            value, slope = density.potential(away)
            if math.isfinite(value) and np.isfinite(slope).all():
                return away, torch_seed
            away = away / 2
    raise DivergenceError("no chain can start: the posterior is finite nowhere near its peak; try narrower priors")


@dataclass(frozen=True)
class ChainStore:
    """One file per chain, ``chain_1.npz``, ..., each of use only to the run that would sample the very same.

    Attributes:
        folder: Where they lie; created when the first one is written.
        digest: Of everything that determines the draws but the chain's number: likelihood, priors, settings, seed and
            versions.
    """

    folder: Path
    digest: str

    @classmethod
    def of(cls, directory: Path, target: Target, settings: NutsSettings, seed: int) -> ChainStore:
        """In a run's directory.

        The likelihood is a black box: what it says at its peak and at a few probes about the mode stands for it.
        """
        likelihood = target.likelihood
        said = [seed, settings, likelihood.names, target.priors, [(name, package_version(name)) for name in DRAWN_WITH]]
        probes = np.random.default_rng(0).standard_normal((PROBES, target.size))
        answers = [np.append(slope, value) for value, slope in map(target.potential, probes)]
        peak = likelihood.sigma_force, likelihood.peak, likelihood.curvature
        digest = hashlib.sha256(repr(said).encode())
        for array in (*peak, target.mode, target.precision, *answers):
            digest.update(np.ascontiguousarray(array, dtype=float).tobytes())
        return cls(directory / CHAINS_FOLDER, digest.hexdigest())

    def place(self, chain: int) -> Path:
        """The file of a chain, counted from 1."""
        return self.folder / f"chain_{chain}.npz"

    def write(self, chain: int, draws: ChainDraws) -> None:
        """Put a finished chain on the disk."""
        identity = {"digest": self.digest, "chain": chain, **stamp(FORMAT)}
        with replacing(self.place(chain)) as temporary, temporary.open("wb") as file:
            np.savez(
                file, allow_pickle=False, q=draws.q, seconds=np.array(draws.seconds), **identity, **draws.statistics
            )

    def read(self, chain: int) -> ChainDraws | None:
        """A chain that was finished before; None, and a line in the log, where its file is not what it should be.

        Raises:
            InputError: A later release wrote it.
        """
        place = self.place(chain)
        if not place.exists():
            return None
        try:
            arrays = read_arrays(place)
            check_layout({name: value.item() for name, value in arrays.items() if value.ndim == 0}, FORMAT, place)
            if (str(arrays["digest"]), int(arrays["chain"])) == (self.digest, chain):
                statistics = {name: arrays[name] for name in STATISTICS}
                return ChainDraws(arrays["q"], statistics, float(arrays["seconds"]))
        except InputError:
            raise
        except (KeyError, TypeError, ValueError):  # it is sampled again
            pass
        log.warning("%s is damaged or of another run: chain %d is sampled again", place, chain)
        return None
