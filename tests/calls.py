"""How tests call the program, what is refused, and the small settings that they call it with."""

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from omegaconf import DictConfig

from pinn_cli.settings.errors import InputError

# A chain, a record and a training small enough for a test, for tests about everything but accuracy.
MEASURED = ("system.ndof=3", "threads=1")
SMALL = ("system.ndof=3", "simulation.duration=12", "simulation.samples=256", "excitation.band=[0.2,1.5]", "threads=1")

# What begins a line that says that a call goes on.
ALIVE = "pinn-run: still running after "

Compose = Callable[..., DictConfig]
PinnRun = Callable[..., "Outcome"]


def limit_files(size: int) -> None:
    """Have the system refuse what makes a file of this process larger, bytes, as a full disk does."""
    import resource

    # Python would keep the beginning of what it compiles, and read it next time.
    sys.dont_write_bytecode, os.environ["PYTHONDONTWRITEBYTECODE"] = True, "1"
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def register(folder: Path, name: str, entry_points: str) -> None:
    """Have Python take a package for installed that has these entry points of pinn-run, as pip does."""
    information = folder / f"{name}-1.dist-info"
    information.mkdir(parents=True)
    (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name.replace('_', '-')}\nVersion: 1\n")
    (information / "entry_points.txt").write_text(f"[pinn_cli.plugins]\n{entry_points}\n")


def refusal(call: Callable[..., Any], *arguments: Any, **settings: Any) -> str:
    """What a call says that refuses its input, in one line."""
    with pytest.raises(InputError) as error:
        call(*arguments, **settings)
    assert "\n" not in str(error.value)
    return str(error.value)


class Outcome:
    """What a call of `pinn-run` ended with."""

    def __init__(self, status: int, out: str, err: str) -> None:
        self.status, self.out = status, out
        # How long a call lasts depends on what else the machine does, and so do the signs that it lives.
        self.err = "".join(line for line in err.splitlines(keepends=True) if not line.startswith(ALIVE))

    def done(self) -> "Outcome":
        """This, of a call that must have gone well."""
        assert self.status == 0, self.err
        return self

    def refused(self, *told: str) -> "Outcome":
        """This, of a call whose input cannot be used: one line, which says all of that."""
        assert (self.status, self.err.count("\n")) == (2, 1), self.err
        assert all(part in self.err for part in told), self.err
        return self

    @property
    def directory(self) -> Path:
        """The run's or the sweep's directory: the last line printed."""
        return Path(self.out.strip().splitlines()[-1])

    @property
    def record(self) -> dict[str, Any]:
        """Of `run.json`."""
        return json.loads((self.directory / "run.json").read_text())

    @property
    def parameters(self) -> pd.DataFrame:
        """The table, by parameter."""
        return pd.read_csv(self.directory / "parameters.csv", index_col="parameter")
