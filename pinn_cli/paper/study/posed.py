"""A configuration as a problem that is ready to be solved, without a process or a directory of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hydra import compose, initialize_config_module

from pinn_cli.cli.config import RunConfig
from pinn_cli.training.estimate import RunContext

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pinn_cli.record.record import Record, Truth
    from pinn_cli.scheme.problem import Problem


@dataclass(frozen=True, eq=False)
class Posed:
    """What `pinn-run` has in hand before it estimates.

    Attributes:
        config: The run's.
        record: What an estimator may see.
        truth: What it is scored against, and nothing else.
        problem: What it is given.
    """

    config: RunConfig
    record: Record
    truth: Truth
    problem: Problem

    @property
    def context(self) -> RunContext:
        """Of an estimate that leaves nothing behind."""
        return RunContext(self.config.device, self.config.seed)


def posed(overrides: Sequence[str]) -> Posed:
    """The problem that ``pinn-run <overrides>`` would solve, its record simulated or read.

    Raises:
        hydra.errors.HydraException: The overrides do not compose.
        InputError: A setting that no run can use.
    """
    with initialize_config_module("pinn_cli.conf", version_base="1.3"):
        config = RunConfig.read(compose("config", overrides=list(overrides)))
    true, prescribed = config.model_error.chains(config.chain)
    measurements = config.source.measure(true)
    record = config.observe(measurements.record)
    return Posed(config, record, measurements.truth, config.scheme.problem(prescribed, record))
