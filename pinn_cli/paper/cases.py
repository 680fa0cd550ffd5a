"""The paper's Tables 1 to 6 and the runs that they need: every case with each of its variants, each once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import pandas as pd

from pinn_cli.report import published

_VALUES = {
    "fitness": published.fitness, "parameters": published.parameters, "wrong values": published.perturbed_parameters
}  # fmt: skip


@dataclass(frozen=True)
class Variant:
    """One way to run every case of a table.

    Attributes:
        name: A word for file and column names.
        title: What a table calls it.
        overrides: Settings as `pinn-run` takes them.
    """

    name: str
    title: str
    overrides: tuple[str, ...] = ()

    @property
    def source(self) -> str:
        """What the row of a table says: whose estimate it is."""
        return self.title if self.name == SMOOTHER.name else f"ours, {self.title}"


SMOOTHER = Variant("kalman_smoother", "Kalman smoother")
# The first variant of every table has the smoother beside it, which solves the same problem.
BESIDE = ("baseline=kalman_smoother",)
UNCERTAIN = Variant("uncertain", "uncertain parameters", BESIDE)
FIXED = Variant("fixed", "fixed parameters", ("scheme.parameter_uncertainty=0",))
MARGINAL = Variant("marginal", "marginal posterior, states uncertain", BESIDE)
CONDITIONAL = Variant(
    "conditional", "conditional posterior, states held fixed as in the paper", ("posterior=conditional",)
)
LAPLACE = Variant("laplace", "Laplace's approximation of the marginal posterior, no sampling", ("posterior=laplace",))


@dataclass(frozen=True)
class CaseTable:
    """A published table whose cases are each run with every variant.

    Attributes:
        name: Of its files.
        title: Heading.
        kind: What it compares.
        published: Its name in the column ``table`` of the published values.
        variants: Ways to run a case; the first is the product's own choice.
    """

    name: str
    title: str
    kind: Literal["fitness", "parameters", "wrong values"]
    published: str
    variants: tuple[Variant, ...] = (UNCERTAIN, FIXED)

    @property
    def values(self) -> pd.DataFrame:
        """The published rows."""
        values = _VALUES[self.kind]()
        return values[values["table"] == self.published]

    @property
    def cases(self) -> list[str]:
        """In the paper's order."""
        return list(dict.fromkeys(self.values["case"]))


TABLES = (
    CaseTable(
        "table1", "Table 1: prescribed, true and estimated parameters of the chain with wrong values", "wrong values",
        "sr-valerr-duf-prescr", (UNCERTAIN,),
    ),
    CaseTable("table2", "Table 2: sparse recovery", "fitness", "sr-summary"),
    CaseTable(
        "table3", "Table 3: state-parameter estimation, parameters of the Duffing chain by noise", "parameters",
        "spe-nonerr-duf",
    ),
    CaseTable(
        "table4", "Table 4: state-parameter estimation, parameters of the Van der Pol chain and with wrong models",
        "parameters", "spe-vdp-err",
    ),
    CaseTable("table5", "Table 5: state-parameter estimation, states", "fitness", "spe-summary"),
    CaseTable(
        "table6", "Table 6: Bayesian parameter estimation, 2-DOF chains", "parameters", "mcmc-results",
        (MARGINAL, CONDITIONAL, LAPLACE),
    ),
)  # fmt: skip


@dataclass(frozen=True)
class PlannedRun:
    """One run of the paper.

    Attributes:
        case: Of ``conf/experiment/paper``.
        variant: How it is run.
    """

    case: str
    variant: Variant

    @property
    def name(self) -> str:
        """Of its directory."""
        return f"{self.case}_{self.variant.name}"

    @property
    def title(self) -> str:
        """In words."""
        return f"{self.case}, {self.variant.title}"

    @property
    def overrides(self) -> tuple[str, ...]:
        """As `pinn-run` takes them."""
        return (f"experiment=paper/{self.case}", *self.variant.overrides)


def planned_runs(tables: Sequence[CaseTable] = TABLES) -> list[PlannedRun]:
    """The runs of some tables, in their order; a case that stands in two tables is run once."""
    runs = [PlannedRun(case, variant) for table in tables for case in table.cases for variant in table.variants]
    return list(dict.fromkeys(runs))
