"""How tests call the program, and the small settings that they call it with."""

from collections.abc import Callable
from pathlib import Path

from omegaconf import DictConfig

# A chain, a record and a training small enough for a test, for tests about everything but accuracy.
MEASURED = ("system.ndof=3", "threads=1")
SMALL = ("system.ndof=3", "simulation.duration=12", "simulation.samples=256", "excitation.band=[0.2,1.5]", "threads=1")

Compose = Callable[..., DictConfig]
PinnRun = Callable[..., "Outcome"]


class Outcome:
    """What a call of `pinn-run` ended with."""

    def __init__(self, status: int, out: str, err: str) -> None:
        self.status, self.out, self.err = status, out, err

    def done(self) -> "Outcome":
        """This, of a call that must have gone well."""
        assert self.status == 0, self.err
        return self

    @property
    def directory(self) -> Path:
        """The run's or the sweep's directory: the last line printed."""
        return Path(self.out.strip().splitlines()[-1])
