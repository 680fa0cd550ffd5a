"""All chains of a posterior, one after the other: those that a killed run had finished are taken over.

Finished chains lie on the disk, so that a run that was killed loses at most the one that it was sampling.
"""

from __future__ import annotations

import hashlib
import logging
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from pinn_cli.posterior.base import PosteriorSamples
from pinn_cli.posterior.nuts import STATISTICS, ChainDraws, NutsSettings, sample_chain
from pinn_cli.posterior.target import Target
from pinn_cli.runs.identity import package_version
from pinn_cli.runs.writing import replacing
from pinn_cli.system.priors import Prior
from pinn_cli.training.estimate import RunContext
from pinn_cli.training.likelihood import ParameterLikelihood

FOLDER = "chains"
PACKAGES = ("pinn-cli", "pyro-ppl", "torch", "numpy")
PROBES = 4

log = logging.getLogger(__name__)


def sample_posterior(
    method: str,
    likelihood: ParameterLikelihood,
    priors: Sequence[Prior],
    chains: int,
    settings: NutsSettings,
    run: RunContext,
) -> PosteriorSamples:
    """Draws of a posterior by NUTS.

    Args:
        method: What the samples call it.
        likelihood: Of p parameters.
        priors: (p,), in the likelihood's order.
        chains: How many.
        settings: Of each.
        run: Its directory, where there is one, keeps every finished chain.

    Raises:
        DivergenceError: The posterior cannot be evaluated anywhere near its peak.
    """
    target = Target(likelihood, priors)
    store = None
    if run.directory is not None:
        digest = digest_of(target, settings, run.seed)
        store = ChainStore(run.directory / FOLDER, digest, (settings.draws, target.size))
    found = [store.read(chain) if store else None for chain in range(1, chains + 1)]
    taken = sum(chain is not None for chain in found)
    if taken:
        log.info("%d of %d chains were finished before and are taken over", taken, chains)
    finished = _sample_missing(found, target, store, settings, run)
    x = target.whitening.coordinates(np.stack([chain.q for chain in finished]))
    statistics = {name: np.stack([chain.statistics[name] for chain in finished]) for name in STATISTICS}
    seconds = np.array([chain.seconds for chain in finished])
    return target.samples(method, x, run.seed, seconds, statistics, settings.warmup)


def _sample_missing(
    found: Sequence[ChainDraws | None],
    target: Target,
    store: ChainStore | None,
    settings: NutsSettings,
    run: RunContext,
) -> list[ChainDraws]:
    missing = sum(chain is None for chain in found)
    iterations = missing * (settings.warmup + settings.draws)
    finished = []
    with tqdm(total=iterations, disable=None if run.progress else True, unit="it", desc="nuts", leave=False) as bar:
        for number, chain in enumerate(found, start=1):
            if chain is not None:
                finished.append(chain)
                continue
            bar.set_postfix_str(f"chain {number} of {len(found)}", refresh=False)
            sampled = sample_chain(target, run.seed, number, settings, bar.update)
            if store:
                store.write(number, sampled)
            finished.append(sampled)
    return finished


@dataclass(frozen=True)
class ChainStore:
    """One file per chain, ``chain_1.npz``, ..., each of use only to the run that would sample the very same.

    Attributes:
        folder: Where they lie; created when the first one is written.
        digest: Of everything that determines the draws but the chain's number (:func:`digest_of`).
        shape: (draws, p + 1).
    """

    folder: Path
    digest: str
    shape: tuple[int, int]

    def place(self, chain: int) -> Path:
        """The file of a chain, counted from 1."""
        return self.folder / f"chain_{chain}.npz"

    def write(self, chain: int, draws: ChainDraws) -> None:
        """Put a finished chain on the disk; it is there, whole, when this returns."""
        content = {"q": draws.q, "seconds": np.array(draws.seconds), **draws.statistics}
        with replacing(self.place(chain)) as beside, beside.open("wb") as file:
            np.savez(file, allow_pickle=False, seal=np.array(self._seal(chain, content)), **content)
            file.flush()
            os.fsync(file.fileno())

    def read(self, chain: int) -> ChainDraws | None:
        """A chain that was finished before; None, and a line in the log, where its file is not what it should be."""
        place = self.place(chain)
        if not place.exists():
            return None
        try:
            with np.load(place, allow_pickle=False) as file:
                content = {name: file[name] for name in ("q", "seconds", *STATISTICS)}
                seal = str(file["seal"])
            whole = content["q"].shape == self.shape and seal == self._seal(chain, content)
        except Exception:  # of all that may be wrong with a file, nothing matters but that the chain is sampled again
            whole = False
        if not whole:
            log.warning("%s is damaged or of another run: chain %d is sampled again", place, chain)
            return None
        statistics = {name: content[name] for name in STATISTICS}
        return ChainDraws(content["q"], statistics, float(content["seconds"]))

    def _seal(self, chain: int, content: Mapping[str, np.ndarray]) -> str:
        """Of the digest, the chain's number and every value."""
        seal = hashlib.sha256(f"{self.digest} {chain}".encode())
        for name in sorted(content):
            array = np.ascontiguousarray(content[name])
            seal.update(f"{name} {array.dtype} {array.shape}".encode())
            seal.update(array.tobytes())
        return seal.hexdigest()


def digest_of(target: Target, settings: NutsSettings, seed: int) -> str:
    """Of everything that determines a chain's draws but its number: likelihood, priors, settings, seed and versions.

    The likelihood is a black box: what it says at its peak and at a few probes about the mode stands for it.
    """
    likelihood = target.likelihood
    said = [seed, settings, likelihood.names, target.priors, [(name, package_version(name)) for name in PACKAGES]]
    probes = np.random.default_rng(0).standard_normal((PROBES, target.size))
    answers = [np.append(slope, value) for value, slope in map(target.potential, probes)]
    numbers = [likelihood.sigma_force, likelihood.peak, likelihood.curvature, target.mode, target.precision, *answers]
    digest = hashlib.sha256(repr(said).encode())
    for array in numbers:
        digest.update(np.ascontiguousarray(array, dtype=float).tobytes())
    return digest.hexdigest()
