"""The paper's tables, published beside ours: ``python -m pinn_cli.paper.single_tables table2 [--output FOLDER]``.

A further table of fitness is one entry of `FITNESS_TABLES`, one of estimated parameters an entry of `PARAMETER_TABLES`;
a table of another kind is one function and one entry of `TABLES`.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from pinn_cli.paper.case_runs import Variant, run_cases
from pinn_cli.paper.comparison import compare_fitness, fitness_markdown, markdown_row
from pinn_cli.paper.parameter_comparison import compare_parameters, parameters_markdown
from pinn_cli.report import published
from pinn_cli.runs.writing import write_table, write_text

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import pandas as pd

    from pinn_cli.paper.case_runs import CaseRun

AUTHORS_SEED = 43810  # of the draws behind the paper's Table 1


@dataclass(frozen=True)
class CaseTable:
    """A published table whose cases are each run with every variant.

    Attributes:
        name: Of the command and the files.
        title: Heading.
        published: The table's name in ``published/fitness.csv`` or ``published/parameters.csv``.
        variants: Ways to run a case.
    """

    name: str
    title: str
    published: str
    variants: tuple[Variant, ...]


UNCERTAIN_AND_FIXED = (
    Variant("uncertain", "uncertain parameters"),
    Variant("fixed", "fixed parameters", ("scheme.parameter_uncertainty=0",)),
)
POSTERIORS = (
    Variant("marginal", "marginal posterior, states uncertain"),
    Variant("conditional", "conditional posterior, states held fixed as in the paper", ("posterior=conditional",)),
    Variant("laplace", "Laplace's approximation of the marginal posterior, no sampling", ("posterior=laplace",)),
)
FITNESS_TABLES = (
    CaseTable("table2", "Table 2: sparse recovery", "sr-summary", UNCERTAIN_AND_FIXED),
    CaseTable("table5", "Table 5: state-parameter estimation, states", "spe-summary", UNCERTAIN_AND_FIXED),
)
PARAMETER_TABLES = (
    CaseTable(
        "table3",
        "Table 3: state-parameter estimation, parameters of the Duffing chain by noise",
        "spe-nonerr-duf",
        UNCERTAIN_AND_FIXED,
    ),
    CaseTable(
        "table4",
        "Table 4: state-parameter estimation, parameters of the Van der Pol chain and with wrong models",
        "spe-vdp-err",
        UNCERTAIN_AND_FIXED,
    ),
    CaseTable("table6", "Table 6: Bayesian parameter estimation, 2-DOF chains", "mcmc-results", POSTERIORS),
)


def fitness_table(table: CaseTable, output: Path) -> int:
    """Run the table's cases and write ``<name>.csv`` and ``<name>.md``; the runs lie in ``<output>/<name>/``."""
    return _case_table(table, published.fitness(), compare_fitness, fitness_markdown, output)


def parameters_table(table: CaseTable, output: Path) -> int:
    """The same for a table of estimated parameters."""
    return _case_table(table, published.parameters(), compare_parameters, parameters_markdown, output)


def _case_table(
    table: CaseTable,
    values: pd.DataFrame,
    compare: Callable[[pd.DataFrame, Sequence[CaseRun]], pd.DataFrame],
    markdown: Callable[[str, pd.DataFrame, Sequence[Variant]], str],
    output: Path,
) -> int:
    values = values[values["table"] == table.published]
    runs, failures = run_cases(list(dict.fromkeys(values["case"])), table.variants, output / table.name)
    comparison = compare(values, runs)
    text = markdown(table.title, comparison, table.variants)
    if failures:
        text += "\n\nFailed:\n" + "".join(f"\n- {failure.splitlines()[0]}" for failure in failures)
    _write(table.name, comparison, text, output)
    return 1 if failures else 0


def perturbed_parameters_table(output: Path) -> int:
    """Write the paper's Table 1, the true parameters of the case with wrong values, beside our draws."""
    comparison = perturbed_parameters_comparison()
    columns = ["parameter", "prescribed", "published", "drawn", "difference"]
    rows = [
        markdown_row(
            str(row["parameter"]), *(f"{row[column]:.2f}" for column in columns[1:-1]), f"{row['difference']:+.4f}"
        )
        for _, row in comparison.iterrows()
    ]
    agree = int((comparison["drawn"].round(2) == comparison["published"]).sum())
    text = "\n".join(
        [
            "# Table 1: prescribed and true parameters of the 6-DOF Duffing chain with wrong values",
            "",
            (
                f"Drawn with `model_error=perturbed model_error.draws=authors model_error.seed={AUTHORS_SEED}`. "
                f"{agree} of {len(comparison)} agree with the published values at two decimals."
            ),
            "",
            markdown_row(*columns),
            markdown_row("---", *("---:" for _ in columns[1:])),
            *rows,
        ]
    )
    _write("table1", comparison, text, output)
    return 0 if agree == len(comparison) else 1


def perturbed_parameters_comparison() -> pd.DataFrame:
    """Columns ``parameter, prescribed, published, drawn, difference`` (drawn less published), in the paper's order."""
    # torch is wanted here only: the other tables run in processes of their own.
    from pinn_cli.report.parameters import true_value
    from pinn_cli.system.building import build_chain
    from pinn_cli.system.connection.duffing import Duffing
    from pinn_cli.system.model_error import PerturbedModelError

    values = published.perturbed_parameters().rename(columns={"true": "published"})
    symbols = values["parameter"].str.rpartition("_")[0]
    prescribed = {str(symbol): list(group) for symbol, group in values.groupby(symbols)["prescribed"]}
    ndof = len(prescribed["k"])
    # The mass is not perturbed, so any will do.
    nominal = build_chain(ndof, Duffing(), m=1.0, **prescribed)
    true, _ = PerturbedModelError(seed=AUTHORS_SEED, draws="authors").chains(nominal)
    drawn = {name: value.numpy() for name, value in true.parameters.items()}
    values["drawn"] = [true_value(name, drawn) for name in values["parameter"]]
    values["difference"] = values["drawn"] - values["published"]
    return values[["parameter", "prescribed", "published", "drawn", "difference"]]


TABLES: dict[str, Callable[[Path], int]] = {
    "table1": perturbed_parameters_table,
    **{table.name: partial(fitness_table, table) for table in FITNESS_TABLES},
    **{table.name: partial(parameters_table, table) for table in PARAMETER_TABLES},
}


def _write(name: str, table: pd.DataFrame, text: str, output: Path) -> None:
    write_table(table, output / f"{name}.csv")
    place = write_text(text, output / f"{name}.md")
    print(f"\n{text}\n\n{place}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Write one of the paper's tables; the exit status is 1 if a run failed or a draw disagrees."""
    parser = argparse.ArgumentParser(
        prog="python -m pinn_cli.paper.single_tables", description="The paper's tables beside ours."
    )
    parser.add_argument("table", choices=sorted(TABLES))
    parser.add_argument("--output", type=Path, default=Path("outputs/tables"), help="folder (default: %(default)s)")
    given = parser.parse_args(arguments)
    return TABLES[given.table](given.output)


if __name__ == "__main__":
    sys.exit(main())
