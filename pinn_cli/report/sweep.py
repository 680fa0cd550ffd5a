"""The tables of a sweep: those of its jobs, one below the other, with the swept settings as leading columns."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import pandas

TABLES = ("fitness.csv", "free_run.csv", "parameters.csv", "score.csv", "identifiability.csv", "diagnostics.csv")


class SweepTables(Callback):
    """Joins the jobs' tables when a sweep ends. Hydra builds it at every start, so nothing slow is imported above."""

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Write each of `TABLES` that the jobs have into the sweep's directory and print its path."""
        directory = Path(config.hydra.sweep.dir)
        for name in TABLES:
            join_tables(directory, name, list(config.hydra.overrides.task))
        if any(directory.glob("*.csv")):
            print(directory)


def join_tables(directory: Path, name: str, overrides: Sequence[str]) -> Path | None:
    """Concatenate one table of every job below `directory`, cell by cell as the jobs wrote it.

    Args:
        directory: Of the sweep. A job's directory is one that holds `.hydra/overrides.yaml`; jobs without the table,
            such as one that failed, are passed over.
        name: Of the table, one of `TABLES`.
        overrides: The sweep's overrides as typed (`seed=0,1`, `system.ndof=3`): those that do not sweep become no
            column, nor does a setting that the tables have a column of the same name for (`seed`, `case`).

    Returns:
        The path written, or None if no job has the table.
    """
    import pandas as pd

    from pinn_cli.report.writing import write_table

    fixed = {override.get_key_element() for override in _parse(overrides) if not override.is_sweep_override()}
    jobs = [path.parent.parent for path in directory.rglob(".hydra/overrides.yaml")]
    tables = [_labelled(job, name, fixed) for job in sorted(jobs, key=_order) if (job / name).is_file()]
    if not tables:
        return None
    return write_table(pd.concat(tables, ignore_index=True), directory / name)


def _labelled(job: Path, name: str, fixed: set[str]) -> pandas.DataFrame:
    """A job's table, all cells as text, with its swept settings put before its own columns."""
    import pandas as pd

    table = pd.read_csv(job / name, dtype=str, keep_default_na=False)
    written = [str(line) for line in OmegaConf.load(job / ".hydra" / "overrides.yaml")]
    swept = [override for override in _parse(written) if override.get_key_element() not in fixed]
    for override in reversed(swept):
        column = override.get_key_element().lstrip("+")
        if column not in table and not column.startswith("hydra."):
            table.insert(0, column, override.get_value_element_as_str())
    return table


def _parse(overrides: Iterable[str]) -> list[Any]:
    return OverridesParser.create().parse_overrides(list(overrides))


def _order(job: Path) -> tuple[int, str]:
    return len(job.as_posix()), job.as_posix()  # 0, 1, ..., 9, 10
