"""The files of a finished run as Python has them: its tables, its response, its posterior, read when asked for."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pinn_cli.runs.resume import read_record
from pinn_cli.settings.errors import InputError
from pinn_cli.settings.suggestion import suggestion

if TYPE_CHECKING:
    import arviz
    import pandas as pd
    import xarray as xr


class RunFiles:
    """What lies in the directory of a finished run.

    Args:
        directory: Of the run; absolute.

    Attributes:
        directory: Where its files lie.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory

    @cached_property
    def run_record(self) -> dict[str, Any]:
        """What ``run.json`` says: seconds by stage, why training stopped, noise levels, versions."""
        return read_record(self.directory)

    @property
    def verdict(self) -> str | None:
        """``sound``, or how far the run is from it; None where there is no verdict."""
        found = self.run_record.get("verdict")
        return None if found is None else str(found)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the verdict is not sound."""
        return tuple(self.run_record.get("reasons", ()))

    @cached_property
    def fitness(self) -> pd.DataFrame:
        """Fitness by group of DOFs and quantity, of every estimator; NaN where the truth is unknown."""
        return self.table("fitness")

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """A row for each parameter: ``estimate``, ``std``, ``lower_90`` and ``upper_90`` beside what was given."""
        return self.table("parameters")

    @cached_property
    def modes(self) -> pd.DataFrame | None:
        """Natural frequencies (Hz), damping ratios and shapes, with 90 % intervals; None where there are none."""
        return self._optional("modes")

    @cached_property
    def residuals(self) -> pd.DataFrame:
        """What the estimate leaves of every sensor."""
        return self.table("residuals")

    @cached_property
    def free_run(self) -> pd.DataFrame | None:
        """How well the estimated structure by itself follows, under the measured forces; None where it has not run."""
        return self._optional("free_run")

    @cached_property
    def validation(self) -> pd.DataFrame | None:
        """The identified system on data that no estimator has seen; None without such data."""
        return self._optional("validation")

    @cached_property
    def history(self) -> pd.DataFrame:
        """A row for each iteration: loss terms and weights."""
        return self.table("history")

    @cached_property
    def response(self) -> xr.Dataset:
        """``displacement``, ``velocity``, ``acceleration``, ``force`` over (``time``, ``dof``), SI units.

        Each has ``<quantity>_std`` beside it, ``<quantity>_observed`` (NaN where there is no sensor) and, where it is
        known, ``<quantity>_true``.
        """
        import xarray as xr

        with xr.open_dataset(self.directory / "response.nc", engine="h5netcdf") as file:
            return file.load()

    @cached_property
    def posterior(self) -> arviz.InferenceData | None:
        """Draws of the parameters; None but with ``scheme=bayesian``."""
        file = self.directory / "posterior.nc"
        if not file.is_file():
            return None
        import arviz

        return arviz.from_netcdf(str(file), engine="h5netcdf")

    @cached_property
    def settings(self) -> dict[str, Any]:
        """Every setting that it ran with."""
        from omegaconf import OmegaConf

        from pinn_cli.settings.yaml_file import read_yaml

        plain: Any = OmegaConf.to_container(read_yaml(self.directory / ".hydra" / "config.yaml"), resolve=False)
        return dict(plain)

    @property
    def tables(self) -> list[str]:
        """Names of all its tables; :meth:`table` reads one."""
        return sorted(file.stem for file in self.directory.glob("*.csv"))

    def table(self, name: str) -> pd.DataFrame:
        """One of its tables, ``drift.csv`` by the name ``drift``.

        Raises:
            InputError: It has no such table.
        """
        import pandas as pd

        check_table(name, self.tables)
        return pd.read_csv(self.directory / f"{name}.csv")

    def _optional(self, name: str) -> pd.DataFrame | None:
        return self.table(name) if name in self.tables else None


def check_table(name: str, tables: Sequence[str]) -> None:
    """See that there is a table of that name.

    Raises:
        InputError: There is none.
    """
    if name not in tables:
        raise InputError("table", name, f"one of {', '.join(tables)}", suggestion(name, tables))
