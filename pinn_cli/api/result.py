"""A finished run as Python has it: its files, its figures, and how a notebook shows it."""

from __future__ import annotations

import html
from functools import cached_property
from typing import TYPE_CHECKING

from pinn_cli.api.plots import Plots
from pinn_cli.api.run_files import RunFiles

if TYPE_CHECKING:
    import pandas as pd

# Which run it is: columns that are the same in every row of a run's tables.
_RUN = ("case", "scheme", "ndof", "nonlinearity", "model_error", "snr_db", "seed")
_ROWS_SHOWN = 40


class Result(RunFiles):
    """A finished run."""

    @cached_property
    def plot(self) -> Plots:
        """Its figures: ``result.plot.response()``."""
        return Plots(self)

    def __repr__(self) -> str:
        case, verdict = self.run_record.get("case"), self.verdict or "no verdict"
        return f"<Result of {case}: {verdict}; {len(self.parameters)} parameters; {self.directory}>"

    def _repr_html_(self) -> str:
        """What a notebook shows: the verdict with its reasons, parameters, and fitness where there is a truth."""
        reasons = "".join(f"<li>{html.escape(reason)}</li>" for reason in self.reasons)
        parts = [
            f"<b>{html.escape(str(self.run_record.get('case')))}</b>: {html.escape(self.verdict or 'no verdict')}",
            f"<ul>{reasons}</ul>" if reasons else "",
            as_html(self.parameters.drop(columns=[*_RUN, "estimator"], errors="ignore")),
            as_html(_overall(self.fitness)),
            f"<code>{html.escape(str(self.directory))}</code>",
        ]
        return "\n".join(part for part in parts if part)


def as_html(table: pd.DataFrame) -> str:
    """A table as a notebook shows it, its columns without content left out; "" of an empty one."""
    table = table.dropna(axis="columns", how="all")
    if table.empty:
        return ""
    return str(table.to_html(index=False, na_rep="", float_format="{:.5g}".format, max_rows=_ROWS_SHOWN, border=0))


def _overall(fitness: pd.DataFrame) -> pd.DataFrame:
    """Of all DOFs, where there is a truth."""
    columns = ["estimator", "quantity", "fitness_percent", "range_fitness_percent"]
    overall = fitness[(fitness["group"] == "all") & fitness["fitness_percent"].notna()]
    return overall[columns]
